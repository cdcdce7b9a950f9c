"""The parts of a study, as declared in a YAML file."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypedDict, Unpack

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import ConfigError, StudyError
from fvslam_graph.core.files import file_name
from fvslam_graph.core.modes import MODES, known_mode, reads
from fvslam_graph.core.outside import Method
from fvslam_graph.core.plugins import Plugin, of_method
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.validation import complaint
from fvslam_graph.core.yaml_files import read_yaml_mapping
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.jobs import VARIANT_SEPARATOR, Job
from fvslam_graph.study.sources import HeldSequence, Source
from fvslam_graph.study.systems import DEFAULT_LIMIT, System


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) < len(values):
        raise ValueError("something is listed twice")
    return values


def _sources(values: Any) -> Any:
    """A sequence of which only the path is given may be written as that path."""
    if not isinstance(values, list | tuple):
        return values
    return [_source(value) for value in values]


def _source(value: Any) -> Any:
    if isinstance(value, Sequence):
        return HeldSequence.of(value)
    return {"path": value} if isinstance(value, str) else value


def _mode(value: Any) -> str | Plugin:
    """A name, or what a function is called."""
    if isinstance(value, Plugin):
        return value
    if isinstance(value, str):
        return known_mode(str(value))
    return _method(getattr(value, "__name__", type(value).__name__), value)


def _method(name: str, function: Method) -> Plugin:
    """A function as a mode."""
    if name in MODES or ":" in name:
        raise ConfigError(f"a function cannot be called '{name}', which is a mode; give it another name")
    return of_method(name, function)


def _distinct_modes(modes: tuple[str | Plugin, ...]) -> tuple[str | Plugin, ...]:
    _distinct(tuple(map(str, modes)))
    return modes


def _distinct_names(sources: tuple[Source, ...]) -> tuple[Source, ...]:
    if len({source.label for source in sources}) < len(sources):
        raise ValueError("two have the same name; give each a name of its own")
    return sources


def _systems(values: Any) -> Any:
    """A system of which only the command is given may be written as that command."""
    if not isinstance(values, dict):
        return values
    return {name: {"command": value} if isinstance(value, str) else value for name, value in values.items()}


def _numbers(value: Any) -> Any:
    """A number of seeds means 0, 1, ... below it."""
    return range(value) if isinstance(value, int) else value


class Study(BaseModel):
    """A grid: every sequence x mode x preset x combination of settings x seed is a run.

    Attributes:
        name: Title of the report.
        sequences: Paths, or groups of what `Source` has: path, name, frames, stride, scale, camera_height, topic, ...;
            in Python also `Sequence`s.
        modes: Of the estimator; in Python also functions of a sequence and a seed, see `core.outside.Method`.
        presets: "paper", "tuned" or both.
        settings: Values to try by setting, such as {"fusion.weight": [0.3, 0.5]}; a single value holds for all runs.
        seeds: How many, or which.
        align: How estimates are brought into the world of the ground truth.
        external: Trajectories of other systems by the name of their sequence: files by the name of the system, as for
            `external_run`.
        systems: Other programs to run by their name: each a command as of `System`, run in the folder of the
            declaration.
        system_limit: Seconds after which one is killed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = "study"
    sequences: Annotated[
        tuple[Source, ...], BeforeValidator(_sources), AfterValidator(_distinct_names), Field(min_length=1)
    ]
    modes: Annotated[
        tuple[Annotated[Any, PlainValidator(_mode), PlainSerializer(str)], ...],
        AfterValidator(_distinct_modes),
        Field(min_length=1),
    ] = MODES
    presets: Annotated[tuple[Literal["paper", "tuned"], ...], AfterValidator(_distinct), Field(min_length=1)] = (
        "tuned",
    )
    settings: dict[str, Any] = {}
    seeds: Annotated[
        tuple[Annotated[int, Field(ge=0)], ...],
        BeforeValidator(_numbers),
        AfterValidator(_distinct),
        Field(min_length=1),
    ] = (0, 1, 2, 3, 4)
    align: Alignment = Alignment.SIM3
    external: dict[str, dict[str, str]] = {}
    systems: Annotated[dict[str, System], BeforeValidator(_systems)] = {}
    system_limit: PositiveFloat = DEFAULT_LIMIT

    @model_validator(mode="after")
    def _external_is_of_sequences(self) -> Self:
        labels = [source.label for source in self.sequences]
        for name in self.external:
            if name not in labels:
                raise ValueError(f"external: '{name}' is none of the sequences {', '.join(labels)}")
        return self

    @model_validator(mode="after")
    def _systems_have_names_of_their_own(self) -> Self:
        taken = {*map(str, self.modes), *(name for files in self.external.values() for name in files)}
        if twice := taken.intersection(self.systems):
            raise ValueError(f"systems: '{min(twice)}' is the name of another method, too")
        return self

    def below(self, folder: Path) -> Self:
        """The same study where its relative paths are those of this folder: absolute, they mean the same anywhere."""

        def absolute(path: str) -> str:
            return str(folder.absolute() / Path(path).expanduser())

        external = {
            sequence: {name: absolute(path) for name, path in files.items()}
            for sequence, files in self.external.items()
        }
        sequences = tuple(source.below(folder) for source in self.sequences)
        systems = {name: system.below(folder) for name, system in self.systems.items()}
        return self.model_copy(update={"sequences": sequences, "external": external, "systems": systems})

    def jobs(self) -> list[Job]:
        """All runs, sequence by sequence; what a mode does not read makes no other runs of it.

        Raises:
            ConfigError: There is no such setting, a value is out of its range, or none of the modes reads it.
        """
        for name in self.settings:
            if not any(reads(mode, name) for mode in self.modes):
                self._checked({name: value} for value in self._values(name))
                raise ConfigError(
                    f"none of the modes {', '.join(map(str, self.modes))} reads the setting '{name}'; leave it out"
                )
        combinations = [
            dict(zip(self.settings, values, strict=True))
            for values in itertools.product(*(self._values(name) for name in self.settings))
        ]
        self._checked(combinations)
        jobs = (
            self._job(source, preset, combination, mode, seed)
            for source, preset, combination, mode, seed in itertools.product(
                self.sequences, self.presets, combinations, self.modes, self.seeds
            )
        )
        return list(dict.fromkeys(jobs))

    def _values(self, name: str) -> list[Any]:
        values = self.settings[name]
        return values if isinstance(values, list) else [values]

    def _checked(self, combinations: Iterable[dict[str, Any]]) -> None:
        for combination in combinations:
            load_config(self.presets[0], settings=[_setting(name, value) for name, value in combination.items()])

    def _job(self, source: Source, preset: str, combination: dict[str, Any], mode: str | Plugin, seed: int) -> Job:
        read = {name: _setting(name, value) for name, value in combination.items() if reads(mode, name)}
        variant = VARIANT_SEPARATOR.join(read[name] for name in read if isinstance(self.settings[name], list))
        settings = [f"seed={seed}", *read.values()]
        if isinstance(mode, str):
            return Job(source, load_config(preset, settings=[f"mode={mode}", *settings]), variant)
        config = load_config(preset, settings=settings)
        return Job(source, config.model_copy(update={"mode": mode.name}), variant, mode)


def load_study(file: Path) -> Study:
    """Read a declaration; relative paths of recordings are relative to its folder.

    Raises:
        StudyError: The file cannot be read, a name is unknown or a value is not possible.
    """
    content = read_yaml_mapping(file, StudyError)

    try:
        study = Study.model_validate({"name": file.stem} | content)
        study.jobs()
    except ValidationError as error:
        raise StudyError(f"{file}: {complaint(error, Study, 'entry')}") from None
    except ConfigError as error:
        raise StudyError(f"{file}: {error}") from None
    return study.below(file.parent)


class ComparisonOptions(TypedDict, total=False):
    """What a comparison may be told besides its sequence, modes and seeds; see `fvslam_graph.compare`."""

    preset: str
    settings: Mapping[str, Any] | None
    external: Mapping[str, str | Path | Method] | None
    systems: Mapping[str, str] | None
    system_limit: float
    align: str


def comparison(
    sequence: Sequence | Source | str | Path,
    modes: Iterable[str | Method],
    seeds: int | Iterable[int],
    **options: Unpack[ComparisonOptions],
) -> Study:
    """The study of one sequence; the arguments are those of `fvslam_graph.compare`.

    Raises:
        StudyError: A value is not possible.
        ConfigError: A setting is unknown or out of its range, or a function cannot be called as one has to be.
    """
    if unknown := set(options) - set(ComparisonOptions.__annotations__):
        raise TypeError(f"a comparison has no argument {', '.join(sorted(unknown))}")
    if isinstance(sequence, Sequence):
        sequence = HeldSequence.of(sequence)
    source = sequence if isinstance(sequence, Source) else Source(path=str(sequence))
    external = options.get("external") or {}
    files = {name: str(file) for name, file in external.items() if isinstance(file, str | Path)}
    methods = [_method(name, what) for name, what in external.items() if not isinstance(what, str | Path)]
    try:
        study = Study.model_validate(
            {
                "name": f"Comparison on {source.label}",
                "sequences": [source],
                "modes": [*modes, *methods],
                "presets": [options.get("preset", "tuned")],
                "settings": dict(options.get("settings") or {}),
                "seeds": seeds if isinstance(seeds, int) else list(seeds),
                "align": options.get("align", Alignment.SIM3),
                "external": {source.label: files} if files else {},
                "systems": dict(options.get("systems") or {}),
                "system_limit": options.get("system_limit", DEFAULT_LIMIT),
            }
        )
    except ValidationError as error:
        raise StudyError(complaint(error, Study, "entry")) from None
    study.jobs()
    return study


def default_folder(study: Study) -> Path:
    """Where a study is kept if nothing else is said."""
    return Path("runs") / file_name(study.name.lower())


def _setting(name: str, value: Any) -> str:
    return f"{name}={json.dumps(value, separators=(',', ':'))}"  # without VARIANT_SEPARATOR
