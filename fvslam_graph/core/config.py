"""All settings, validated and frozen, one group per block, and the two presets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationError

from fvslam_graph.core.choices import RELATIVE_SOURCES, Mode, Preset, ScaleSource
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.modes import ModeName, TrackerName, outside_mode, outside_tracker
from fvslam_graph.core.plugins import Origin
from fvslam_graph.core.validation import complaint
from fvslam_graph.core.yaml_files import parse_yaml, read_yaml_mapping


class _Group(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FeatureSettings(_Group):
    """Corners and their association."""

    association: TrackerName = "klt"  # klt, ncc, or a tracker of another package
    count: PositiveInt = Field(360, ge=8)  # corners per image, spread over a grid
    octave: int = Field(1, ge=0, le=3)  # corners are detected in the image halved so many times: less noise, less time
    threshold: PositiveInt = Field(7, le=255)  # FAST: grey levels between a corner and its surround
    spacing: int = Field(8, ge=0)  # pixels between new corners and those that exist
    klt_window: PositiveInt = Field(11, ge=5)  # pixels, side of the aligned patch
    klt_levels: int = Field(3, ge=0, le=6)  # pyramid levels above the full image
    klt_backward: PositiveFloat = 0.5  # pixels a point may miss its start by, tracked there and back
    ncc_threshold: float = Field(0.8, ge=0, le=1)  # least correlation of matched patches
    ncc_radius: PositiveFloat = 80.0  # pixels, how far a match is looked for along each axis


class VoSettings(_Group):
    """Relative pose from two views."""

    min_inliers: PositiveInt = Field(20, ge=6)  # fewer, and the motion model carries on
    min_inlier_share: float = Field(0.5, ge=0, le=1)  # of the tracks that two views must explain
    ransac_threshold: PositiveFloat = 0.7  # pixels, Sampson distance of an inlier in RANSAC
    ransac_iterations: PositiveInt = 25  # at least
    static_parallax: PositiveFloat = 0.3  # pixels; less, beyond a small rotation, is standing still
    static_rotation: PositiveFloat = 0.0035  # rad; a vehicle that stands still may shake by this
    min_parallax: PositiveFloat = 0.7  # pixels; above, two views tell a baseline where no depths are known yet
    keyframe_parallax: PositiveFloat = 4.0  # pixels; above, they tell it well, and the image becomes the reference
    keyframe_tracks: float = Field(0.5, ge=0, le=1)  # share of the reference's points; below, likewise
    max_acceleration: PositiveFloat = 3.0  # m/s^2, standard deviation, of the motion model
    max_angular_acceleration: PositiveFloat = 1.0  # rad/s^2, likewise
    calibrate: bool = True  # a calibration that is grossly wrong is corrected


class GroundSettings(_Group):
    """The ground plane as a scale source."""

    patches: PositiveInt = 300  # aligned per pair of images
    min_patches: PositiveInt = 40  # fewer, and the ground was not seen
    reach: PositiveFloat = 15.0  # heights; how far away ground is used
    half_width: PositiveFloat = 4.0  # heights; how far to either side
    roughness: PositiveFloat = 0.03  # share of the height by which true ground departs from its plane


class ScaleSettings(_Group):
    """Metres per unit baseline."""

    source: ScaleSource = ScaleSource.PLANE
    plane_sigma: PositiveFloat = 0.02  # of log scale from one view of a ground as rough as it may be,
    bias_sigma: PositiveFloat = 0.04  # and of what it has in common with neighbouring views,
    bias_correlation_keyframes: PositiveFloat = 5.0  # which decays to a third over so many
    map_sigma: PositiveFloat = 0.006  # of log scale, usual drift for each keyframe over which the map carries it
    ground: GroundSettings = GroundSettings()

    @property
    def relative(self) -> bool:
        """Whether nothing tells metres, so that the first scale is a convention."""
        return self.source in RELATIVE_SOURCES


class SlamSettings(_Group):
    """EKF visual SLAM."""

    interleave: PositiveInt | None = None  # every how many frames; by default 1 in mode vslam, else the paper's 5
    min_landmarks: PositiveInt = Field(25, ge=8, le=1000)  # measured in every frame, where the image has as many
    min_matches: PositiveFloat = 3.0  # of landmarks at known depths; fewer that agree, and the motion model carries on
    min_share: float = Field(0.15, ge=0, le=1)  # of the matches, that have to agree, likewise
    # What predicts the next frame; by default the velocity in mode vslam, odometry where both run.
    motion: Literal["constant_velocity", "odometry"] | None = None
    # Where odometry runs: landmarks are searched in their ellipses (the paper), or followed by its tracks in between.
    association: Literal["search", "tracks"] = "tracks"
    # Whether followed landmarks are aligned with their reference patch, or taken where their track is, which drifts.
    alignment: bool = True
    shorten: bool = False  # whether fewer matches than needed halve the interval, until they suffice again
    linear_noise: PositiveFloat = 1.0  # m/s^1.5, root of the spectral density that drives the velocity
    angular_noise: PositiveFloat = 0.3  # rad/s^1.5, likewise
    pixel_sigma: PositiveFloat = 0.5  # pixels, of a matched landmark along each axis
    linearisation_slack: PositiveFloat = 1.0  # pixels by which a match may depart from what the others tell
    depth_spread: PositiveFloat = 0.5  # standard deviation of log distance of a landmark against those around it
    unknown_distance: PositiveFloat = 10.0  # metres, of landmarks where the map is lost at once
    ncc_threshold: float = Field(0.7, ge=0, le=1)  # least correlation of a match
    search_radius: PositiveInt = 80  # pixels at most along each axis, however large an ellipse is


class FusionSettings(_Group):
    """How the estimates of both are made one."""

    weight: float = Field(0.5, ge=0, le=1)  # of visual SLAM in the mean
    geodesic: bool = False  # whether the mean is that of SE(3), instead of position and rotation apart
    criterion: Literal["determinant", "trace"] = "determinant"  # what covariance intersection makes smallest


class GraphSettings(_Group):
    """The factor graph."""

    odometry: Literal["between", "essential"] = "between"  # six degrees of freedom, or five and a length
    landmarks: Literal["projection", "bearing_range", "smart", "none"] = "projection"
    kernel: Literal["huber", "cauchy", "geman_mcclure", "none"] = "cauchy"
    kernel_width: PositiveFloat = 2.385  # deviations beyond which a measurement counts for less; 95 % efficient
    # No pixel counts twice: odometry counts for as much less as landmarks count (with `common_noise`, that is little),
    # or it does without tracks that are landmarks.
    shared_pixels: Literal["deflate", "exclude", "ignore"] = "deflate"
    deflation: PositiveFloat = 1.02  # of the covariance of odometry, where `deflate`
    # Odometry's lengths have a scale in common, which is smoothed with all else; or each one its own.
    scale_model: Literal["chain", "independent"] = "chain"
    # The online pose: where the graph has the camera, but what lies behind it in the scale in which it was published,
    # so that learning the scale does not bend the path, and corrections over an interval; or all as it is known now,
    # which makes the camera jump.
    online: Literal["continuous", "latest"] = "continuous"
    pixel_sigma: PositiveFloat = 0.15  # pixels, of a landmark along each axis, until its noise was measured
    # The common error of all landmarks of an image, in deviations of one of them: their number does not average it out.
    common_noise: float = Field(1.0, ge=0)
    # How well the calibration is known that the images come with, as a rule: it is estimated with all else.
    focal_sigma: float = Field(0.001, ge=0)  # share of the focal length
    distortion_sigma: float = Field(0.001, ge=0)  # radial, k1
    clock_sigma: float = Field(0.03, ge=0)  # seconds, of the clock of GNSS fixes against that of the images, likewise
    min_views: int = Field(3, ge=2)  # of a landmark that enters the graph
    max_zoom: float = Field(1.6, ge=1)  # nearer or farther than at first by this factor, its patch looks too different
    min_parallax: PositiveFloat = 3.0  # pixels between the first and the last view of a landmark that enters
    max_new: PositiveInt = 60  # landmarks that enter at once
    lag: PositiveFloat | None = None  # seconds for which variables are kept; all, if not given
    relinearise: PositiveFloat = 0.01  # metres; a variable that moves farther is linearised again
    heights: bool = False  # whether the readings of an altimeter are factors: for level ground


class Config(_Group):
    """Everything that a run depends on, apart from the sequence."""

    preset: Preset = Preset.TUNED  # which one the settings started from
    mode: ModeName = Mode.VO.value
    seed: int = Field(0, ge=0)
    features: FeatureSettings = FeatureSettings()
    vo: VoSettings = VoSettings()
    scale: ScaleSettings = ScaleSettings()
    slam: SlamSettings = SlamSettings()
    fusion: FusionSettings = FusionSettings()
    graph: GraphSettings = GraphSettings()

    def in_relative_scale(self) -> Config:
        """The same settings where nothing tells metres."""
        return self.model_copy(update={"scale": self.scale.model_copy(update={"source": ScaleSource.MAP})})

    @property
    def origins(self) -> list[Origin]:
        """Where the parts of other packages come from."""
        found = (outside_mode(self.mode), outside_tracker(self.features.association))
        return [plugin.origin for plugin in found if plugin is not None]

    @property
    def interleave(self) -> int:
        """Every how many frames visual SLAM runs."""
        return self.slam.interleave or (1 if self.mode == Mode.VSLAM else 5)

    @property
    def odometry_is_prior(self) -> bool:
        """Whether visual odometry predicts the next frame of visual SLAM."""
        return (self.slam.motion or ("constant_velocity" if self.mode == Mode.VSLAM else "odometry")) == "odometry"

    @property
    def tracks_excluded(self) -> bool:
        """Whether odometry does without tracks that are landmarks."""
        return self.mode == Mode.GRAPH and self.graph.shared_pixels == "exclude"

    @property
    def needs_odometry(self) -> bool:
        """Whether visual odometry runs on every frame, and not only until visual SLAM has started."""
        return self.mode != Mode.VSLAM or self.odometry_is_prior or self.interleave > 1


# The defaults above are `tuned`. `paper` is what the paper says: FAST corners matched as patterns between consecutive
# frames, 25 features and more.
_PAPER: dict[str, Any] = {
    "features": {"association": "ncc", "octave": 0, "threshold": 20},
    "vo": {"min_inliers": 25, "min_inlier_share": 0.3, "keyframe_parallax": 0.7, "calibrate": False},
    "slam": {"ncc_threshold": 0.8, "association": "search"},
}


# A graph is worth more landmarks than a filter can afford on every frame; they come only at interleaved ones.
_GRAPH: dict[str, Any] = {"slam": {"min_landmarks": 60}}


def load_config(preset: str | None = None, file: Path | None = None, settings: Sequence[str] = ()) -> Config:
    """A preset, changed by a YAML file and then by single settings.

    Args:
        preset: "paper" or "tuned"; where it is not given, the one that the file names, else "tuned".
        file: A mapping with the groups and names of Config, such as the config.yaml of a run; what it does not name
            stays as in the preset.
        settings: "group.name=value" each, value in YAML.

    Raises:
        ConfigError: A file cannot be read, a name is unknown or a value is out of its range.
    """
    changes: dict[str, Any] = {"preset": "tuned"}
    if file is not None:
        _merge(changes, read_yaml_mapping(file, ConfigError))
    if preset is not None:
        changes["preset"] = preset
    for setting in settings:
        _merge(changes, _parse(setting))
    values: dict[str, Any] = {}
    if changes["preset"] == "paper":
        _merge(values, _PAPER)
    if changes.get("mode") == Mode.GRAPH:
        _merge(values, _GRAPH)
    _merge(values, changes)
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise ConfigError(complaint(error, Config, "setting")) from None


def _parse(setting: str) -> dict[str, Any]:
    """`a.b=1` as {"a": {"b": 1}}."""
    name, equals, value = setting.partition("=")
    if not equals:
        raise ConfigError(f"a setting is written group.name=value, not '{setting}'")
    parsed = parse_yaml(value, f"the value of '{setting}'", ConfigError)
    *groups, last = name.strip().split(".")
    values: dict[str, Any] = {last: parsed}
    for group in reversed(groups):
        values = {group: values}
    return values


def _merge(values: dict[str, Any], changes: dict[str, Any]) -> None:
    for key, change in changes.items():
        if isinstance(change, dict):
            if not isinstance(values.get(key), dict):
                values[key] = {}
            _merge(values[key], change)
        else:
            values[key] = change
