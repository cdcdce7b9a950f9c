"""YAML that people hand over, and what is said about that which is none."""

import os

import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import CameraError, ConfigError, StudyError
from fvslam_graph.core.yaml_files import MAX_YAML_SIZE, read_yaml_mapping
from fvslam_graph.study.spec import load_study

BAD = {
    "cut": (b"a: [1", "is not valid YAML: while parsing a flow sequence"),
    "tag": (b"a: !!python/object:os.system x", "is not valid YAML: could not determine a constructor"),
    "no integer": (b'a: !!int "abc"', "is not valid YAML: invalid literal"),
    "no truth": (b'a: !!bool "abc"', "is not valid YAML"),
    "no time": (b'a: !!timestamp "abc"', "is not valid YAML"),
    "digits": (b"a: " + b"9" * 5000, "is not valid YAML"),
    "huge": (b"a: 9223372036854775808", "is too large a number"),
    "depth": (b"a: " + b"[" * 500, "is nested too deeply"),
    "itself": (b"a: &a [*a]", r"the alias '\*a' is not read"),
    "bomb": (b"a: &a [0, 0]\nb: &b [*a, *a]\nc: [*b, *b]", r"the alias '\*a' is not read in line 2"),
    "twice": (b"a: {b: 1, b: 2}", "'b' is given twice"),
    "key": (b"[a]: 1\n{b: c}: 2", "is not valid YAML"),
    "list": (b"- 1", "is not a YAML file of the form 'key: value'"),
    "nothing": (b"", "is not a YAML file of the form"),
    "zeros": (bytes(100), "cannot be read as text: it holds NUL bytes"),
    "another encoding": (b"\xff\xfea\x00:\x001\x00", "cannot be read as text"),
    "size": (b"#" * (MAX_YAML_SIZE + 1), "at most 1 MB of text are read"),
}


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (lambda path: read_yaml_mapping(path, CameraError), CameraError),
        (lambda path: load_config(file=path), ConfigError),
        (load_study, StudyError),
    ],
)
@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_yaml_is_one_sentence(tmp_path, read, error, kind):
    content, complaint = BAD[kind]
    path = tmp_path / "some.yaml"
    path.write_bytes(content)
    with pytest.raises(error, match=rf"some\.yaml.*{complaint}") as caught:
        read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", ["[" * 500, '!!int "abc"', "&a [*a]", "9" * 5000])
def test_a_setting_that_is_no_yaml_is_one_sentence(value):
    with pytest.raises(ConfigError, match=r"the value of 'seed=.*is not valid YAML"):
        load_config(settings=[f"seed={value}"])


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf", b"%YAML:1.0\r\n---\r\n"])
@pytest.mark.parametrize("suffix", [b"", b"---\r\n"])
def test_what_other_tools_and_systems_add(tmp_path, prefix, suffix):
    path = tmp_path / "some.yaml"
    path.write_bytes(prefix + b"date: 2024-02-30\r\nm: !!opencv-matrix\r\n  data: [1, 2]\r\n1: b\r\n" + suffix)
    assert read_yaml_mapping(path, CameraError) == {"date": "2024-02-30", "m": {"data": [1, 2]}, "1": "b"}


def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    for path, complaint in ((tmp_path / "pipe.yaml", "is no regular file"), (tmp_path, "is a folder")):
        with pytest.raises(CameraError, match=complaint):
            read_yaml_mapping(path, CameraError)
    with pytest.raises(CameraError, match=r"absent\.yaml is missing"):
        read_yaml_mapping(tmp_path / "absent.yaml", CameraError)
