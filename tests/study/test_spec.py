"""A study is declared in a file, and wrong declarations are one sentence."""

import pytest

from fvslam_graph.core.choices import Mode
from fvslam_graph.core.errors import ConfigError, StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.spec import Study, comparison, load_study

GRID = """
sequences:
  - synthetic:uav?frames=60
  - {path: recordings/a, name: A, frames: "0:50", camera_height: 1.65}
modes: [vo, average]
settings: {fusion.weight: [0.3, 0.5], slam.shorten: true}
seeds: 3
external:
  A: {DSO: results/dso.tum, ORB-SLAM3: /abs/orb.tum@0.1}
"""


def test_a_grid(tmp_path):
    file = tmp_path / "grid.yaml"
    file.write_text(GRID)
    study = load_study(file)
    jobs = study.jobs()
    assert (study.name, study.align) == ("grid", Alignment.SIM3)
    assert len(jobs) == len(set(jobs)) == 2 * 3 * (1 + 2)  # vo does not read the weight
    assert [job.labels() for job in (jobs[0], jobs[-1])] == [
        {
            "sequence": "synthetic:uav?frames=60",
            "mode": "vo",
            "preset": "tuned",
            "variant": "",
            "seed": 0,
        },
        {"sequence": "A", "mode": "average", "preset": "tuned", "variant": "fusion.weight=0.5", "seed": 2},
    ]
    assert (jobs[-1].config.fusion.weight, jobs[-1].config.slam.shorten) == (0.5, True)
    assert (jobs[-1].source.path, jobs[-1].source.frames) == (str(tmp_path / "recordings/a"), "0:50")
    assert study.external["A"] == {"DSO": str(tmp_path / "results/dso.tum"), "ORB-SLAM3": "/abs/orb.tum@0.1"}


def test_what_is_not_said():
    study = Study(sequences=["synthetic:uav"])
    assert (study.modes, study.presets, study.seeds) == (tuple(Mode), ("tuned",), (0, 1, 2, 3, 4))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("sequence: [a]", "the entry 'sequences' is missing"),
        ("sequences: [a]\nseed: 3", "there is no entry 'seed'; the nearest is 'seeds'"),
        (
            "sequences: [{path: a, frame: x}]",
            "there is no entry 'sequences.0.frame'; the nearest is 'sequences.frames'",
        ),
        ("sequences: [a]\nmodes: [vi]", "the entry 'modes.0' cannot be 'vi'"),
        ("sequences: [a]\nmodes: [vo, vo]", "something is listed twice"),
        (
            "sequences: [a]\nsettings: {fusion.weigth: 3}",
            "there is no setting 'fusion.weigth'; the nearest is 'fusion.weight'",
        ),
        ("sequences: [a]\nsettings: {fusion.weight: [0.5, 3]}", "the setting 'fusion.weight' cannot be 3"),
        ("sequences: [a, b/a]", "two have the same name"),
        ("sequences: [a]\nmodes: [vo]\nsettings: {graph.lag: 5}", "none of the modes vo reads the setting 'graph.lag'"),
        ("sequences: [a]\nmodes: [vo]\nsettings: {graph.lga: 5}", "there is no setting 'graph.lga'"),
        ("sequences: 5", "the entry 'sequences' cannot be 5"),
        ("sequences: []", "at least 1 item"),
        ("sequences: [a]\nseeds: 0", "at least 1 item"),
        ("sequences: [a]\nseeds: [-1]", "the entry 'seeds.0' cannot be -1"),
        ("sequences: [a]\nalign: sim", "the entry 'align' cannot be 'sim'"),
        ("sequences: [a]\nexternal: {b: {DSO: f}}", "'b' is none of the sequences a"),
        ("- 1", "is not a YAML file of the form"),
        ("a: [", "is not valid YAML"),
    ],
)
def test_a_wrong_declaration_is_one_sentence(tmp_path, text, complaint):
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(StudyError) as error:
        load_study(file)
    assert complaint in str(error.value)
    assert str(file) in str(error.value) and "\n" not in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(StudyError, match=r"absent\.yaml is missing"):
        load_study(tmp_path / "absent.yaml")


def test_a_comparison():
    study = comparison(
        "data/a", ["vo"], 2, preset="paper", settings={"vo.min_inliers": 30}, external={"DSO": "dso.tum"}, align="se3"
    )
    (first, second) = study.jobs()
    assert (first.config.preset, first.config.vo.min_inliers, second.config.seed) == ("paper", 30, 1)
    assert (study.name, study.external) == ("Comparison on a", {"a": {"DSO": "dso.tum"}})
    with pytest.raises(ConfigError, match="there is no setting"):
        comparison("a", ["vo"], 1, settings={"vo.nothing": 1})
    with pytest.raises(StudyError, match=r"'modes\.0' cannot be 'fast'"):
        comparison("a", ["fast"], 1)
