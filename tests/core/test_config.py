"""Settings: presets, files and single values, and what is said about those that cannot be."""

import pytest
import yaml
from pydantic import ValidationError

from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import Config, load_config
from fvslam_graph.core.errors import ConfigError


def test_presets():
    tuned, paper = load_config("tuned"), load_config("paper")
    assert tuned == Config()
    assert (tuned.preset, paper.preset) == ("tuned", "paper")
    assert (tuned.features.association, paper.features.association) == ("klt", "ncc")
    assert paper.vo.min_inliers == 25  # the paper: 25 features and more
    assert paper.scale == tuned.scale


def test_a_file_changes_the_preset_and_single_settings_change_the_file(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text("features: {count: 300, spacing: 5}\nscale: {ground: {reach: 9}}\nseed: 4\n")
    paper = load_config("paper")
    config = load_config("paper", file, ["features.count=200", "scale.source=map", "scale.ground.patches=99"])
    assert config.preset == "paper"
    assert config.features.association == "ncc"
    assert (config.features.count, config.features.spacing, config.seed) == (200, 5, 4)
    assert config.scale.source is ScaleSource.MAP
    assert (config.scale.ground.reach, config.scale.ground.patches) == (9, 99)
    assert load_config("paper") == paper  # a preset is not changed by its use


def test_a_group_can_be_set_at_once():
    config = load_config(settings=["vo={min_inliers: 30, ransac_threshold: 2}", "vo.min_inliers=31"])
    assert (config.vo.min_inliers, config.vo.ransac_threshold) == (31, 2)


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_the_effective_settings_read_back_are_the_same(tmp_path, preset):
    config = load_config(preset, settings=["seed=7", "scale.source=map", "vo.ransac_threshold=0.7"])
    file = tmp_path / "config.yaml"
    file.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False))
    assert load_config(file=file) == config


def test_a_preset_named_in_a_file_is_the_one_that_the_rest_comes_from(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text("preset: paper\nvo: {min_inliers: 40}\n")
    assert load_config(file=file) == load_config("paper", settings=["vo.min_inliers=40"])
    assert load_config("tuned", file) == load_config(settings=["vo.min_inliers=40"])


def test_settings_are_frozen():
    with pytest.raises(ValidationError):
        load_config().vo.min_inliers = 3


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("vo.min_inlier=20", r"no setting 'vo\.min_inlier'; the nearest is 'vo\.min_inliers'"),
        ("min_inliers=20", r"no setting 'min_inliers'; the nearest is 'vo\.min_inliers'"),
        ("scale.ground.patchs=1", r"no setting 'scale\.ground\.patchs'; the nearest is 'scale\.ground\.patches'"),
        ("sede=1", "no setting 'sede'; the nearest is 'seed'"),
        ("vo.min_inliers=3", r"'vo\.min_inliers' cannot be 3: input should be greater than or equal to 6"),
        ("vo.min_inliers=many", r"'vo\.min_inliers' cannot be 'many': input should be a valid integer"),
        ("vo.min_inliers=", r"'vo\.min_inliers' cannot be None: input should be a valid integer"),
        ("vo.ransac_threshold=.nan", r"'vo\.ransac_threshold' cannot be nan: "),
        ("vo.ransac_threshold=.inf", r"'vo\.ransac_threshold' cannot be inf: input should be a finite number"),
        ("seed=-1", "'seed' cannot be -1: "),
        ("scale.source=gps", r"'scale\.source' cannot be 'gps': input should be 'plane', 'map', 'oracle' or 'unit'"),
        ("preset=fast", "'preset' cannot be 'fast': input should be 'paper' or 'tuned'"),
        ("vo=3", r"'vo' is a group of settings and cannot be 3; set vo\.NAME"),
        ("vo.min_inliers", r"a setting is written group\.name=value, not 'vo\.min_inliers'"),
        ("vo.min_inliers=[1", r"the value of 'vo\.min_inliers=\[1' is not valid YAML"),
    ],
)
def test_a_bad_setting_is_one_sentence(setting, complaint):
    with pytest.raises(ConfigError, match=complaint) as caught:
        load_config(settings=[setting])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"vo: [1", "is not valid YAML"),
        (b"\xff\xfe\x00", "cannot be read as text"),
        (b"- 1\n", "is not a YAML file of the form"),
        (b"", "is not a YAML file of the form"),
        (b"1: 2\n", "there is no setting '1'"),
        (b"vo: {min_inlier: 20}\n", r"the nearest is 'vo\.min_inliers'"),
    ],
)
def test_a_bad_file_is_one_sentence(tmp_path, content, complaint):
    file = tmp_path / "settings.yaml"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=complaint) as caught:
        load_config(file=file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.yaml is missing"):
        load_config(file=tmp_path / "absent.yaml")


def test_the_mode_of_a_file_and_what_wins(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text("mode: graph\npreset: paper\nseed: 4\n")
    repeated = load_config(file=file)
    assert (repeated.mode, repeated.preset, repeated.seed) == ("graph", "paper", 4)
    changed = load_config("tuned", file, ["mode=vslam", "seed=5"])
    assert (changed.mode, changed.preset, changed.seed) == ("vslam", "tuned", 5)
