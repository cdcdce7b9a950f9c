"""The report: what it holds, and how it looks and works in a browser."""

import html
import json
import re
import shutil
import subprocess

import pytest

from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.report import Cell, grouped

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DARK = "--blink-settings=preferredColorScheme=0"
READABLE = 4.5  # contrast that WCAG AA asks of text


def test_rows_stand_below_their_sequence_and_the_best_is_marked():
    table = Table(
        ("sequence", "mode", "preset", "scale", "APE (m)", "NEES"),
        [
            ["03", "vo", "tuned", "plane", "0.40 (0.39-0.41)", "5.0"],
            ["03", "graph", "tuned", "plane", "0.30", "4.0"],
            ["04", "vo", "tuned", "plane", "-", "-"],
            ["04", "graph", "tuned", "plane", "0.2", "-"],
        ],
        4,
        keys=3,
    )
    found = grouped(table)
    assert found.columns == ("mode", "APE (m)", "NEES", "scale")
    (name, rows), (_, alone) = found.groups
    assert name == "03"
    assert rows[0] == [Cell("vo"), Cell("0.40", "(0.39-0.41)"), Cell("5.0"), Cell("plane")]
    assert rows[1] == [Cell("graph"), Cell("0.30", best=True), Cell("4.0"), Cell("plane")]
    assert [row[1] for row in alone] == [Cell("-"), Cell("0.2")]  # alone, it is no best


def test_it_needs_nothing_else_and_says_all(small_study):
    text = (small_study / "report.html").read_text()
    assert "A &lt;small&gt; study" in text and "<small> study" not in text
    assert not re.findall(r"""(?:src|href)=["']?(?!#)[^"'> ]+""", text.replace("xlink:", ""))
    for word in ("lost_100%", "does not exist", "gtsam:", "platform:", "road &amp; facades", "too few recordings"):
        assert word in text
    assert text.index("<h2>Trajectories") < text.index("<h2>Results") < text.index("<h2>All runs")
    assert text.count("<svg") == 3 + 2 * 5
    assert ">travelled distance of the ground truth (m)</text>" in text
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    said = re.findall(r"<li>(.*?)</li>", text)
    assert len(said) == len(set(said)) > 0


PROBE = """
<iframe id="page" style="border:0" width="{width}" height="900" srcdoc="{page}"></iframe>
<script>
  const frame = document.getElementById("page");
  frame.onload = () => {{
    const page = frame.contentDocument, view = frame.contentWindow;
    page.querySelectorAll("details").forEach(details => details.open = true);
    const light = colour => {{
      const parts = colour.match(/[\\d.]+/g).map(Number);
      const linear = parts.slice(0, 3).map(v => v / 255 <= 0.04045 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4);
      return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
    }};
    const contrast = element => {{
      const ink = light(view.getComputedStyle(element).color), paper = light(paperBelow(element));
      return (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
    }};
    const paperBelow = element => {{
      for (let at = element; at; at = at.parentElement) {{
        const colour = view.getComputedStyle(at).backgroundColor;
        if (!/, 0\\)$/.test(colour)) return colour;
      }}
      return dark ? "rgb(18, 18, 18)" : "rgb(255, 255, 255)";
    }};
    const dark = view.matchMedia("(prefers-color-scheme: dark)").matches;
    const summary = page.querySelector("table"), ape = [...summary.tHead.rows[0].cells].findIndex(
      cell => cell.textContent.startsWith("APE"));
    const values = () => [...summary.tBodies[1].rows].slice(1).map(row => row.cells[ape].textContent);
    const shown = summary.tBodies[0].rows[1].cells[ape].getBoundingClientRect();
    const outside = [...page.querySelectorAll("svg")].flatMap(svg => {{
      const box = svg.getBoundingClientRect();
      return [...svg.querySelectorAll("text")].filter(text => {{
        const inner = text.getBoundingClientRect();
        return inner.left < box.left - 3 || inner.right > box.right + 3 || inner.bottom > box.bottom + 3;
      }}).map(text => text.textContent);
    }});
    const sticky = summary.querySelector("th[scope=row]"), wide = summary.parentElement;
    const fits = [...page.querySelectorAll(".wide")].map(box => box.scrollWidth <= box.clientWidth);
    const click = () => summary.tHead.rows[0].cells[ape].querySelector("button").click();
    const before = values(); click(); const rising = values(); click(); const falling = values();
    wide.scrollLeft = 60;
    const stays = sticky.getBoundingClientRect().left;
    const filter = page.getElementById("filter");
    const rows = () => [...summary.querySelectorAll("tbody th[scope=row]")].filter(
      cell => cell.offsetParent).map(cell => cell.textContent);
    const typed = text => {{ filter.value = text; filter.dispatchEvent(new view.Event("input")); return rows(); }};
    const texts = "p, li, td, th, button, h1, figcaption, pre";
    const svgs = [...page.querySelectorAll("svg")].map(svg => svg.getBoundingClientRect().width);
    const reachable = [...page.querySelectorAll("button, input, .wide, summary")].every(item => item.tabIndex === 0);
    const found = {{
      dark, before, rising, falling, outside, fits, stays, reachable, left: shown.left, right: shown.right,
      covered: sticky.offsetWidth, width: page.documentElement.scrollWidth, average: typed("average"),
      facades: [typed("facades vo"), [...page.querySelectorAll("section")].map(section => section.hidden)],
      svgs, contrast: Math.min(...[...page.querySelectorAll(texts)].map(contrast)),
    }};
    document.body.innerHTML = `<pre>${{JSON.stringify(found)}}</pre>`;
  }};
</script>
"""


@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here; on Debian: apt-get install chromium")
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_in_a_browser(small_study, tmp_path, width, dark):
    """At the width of a desktop and of a phone: nothing is cut, the APE is in view, tables sort and filter."""
    page = html.escape((small_study / "report.html").read_text())
    (tmp_path / "probe.html").write_text(PROBE.format(width=width, page=page))
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=20000", "--window-size=1400,1000", "--dump-dom", *([DARK] if dark else [])]
    shown = subprocess.run([*command, (tmp_path / "probe.html").as_uri()], capture_output=True, text=True).stdout
    match = re.search(r"<pre>(.*?)</pre>", shown, re.DOTALL)
    assert match, shown[:1000]
    found = json.loads(html.unescape(match[1]))
    assert found["dark"] == dark
    assert found["width"] <= width
    assert 80 < found["covered"] <= found["left"] < found["right"] <= width
    assert found["outside"] == []
    assert all(100 < wide <= width for wide in found["svgs"])
    assert all(found["fits"]) or width < 1000
    assert 0 <= found["stays"] < 40
    assert found["reachable"] and found["contrast"] >= READABLE

    def numbers(cells):
        return [float("inf") if cell == "-" else float(cell.split()[0]) for cell in cells]

    assert len(found["before"]) == 5
    assert numbers(found["rising"]) == sorted(numbers(found["before"]))
    assert numbers(found["falling"]) == sorted(numbers(found["before"]), reverse=True)
    assert found["average"] == ["average", "average", "average"]
    assert found["facades"] == [["vo"], [True, False]]
