"""The parts of a study, as declared in a YAML file."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from fvslam_graph.core.config import Mode, load_config
from fvslam_graph.core.errors import ConfigError, StudyError
from fvslam_graph.core.files import file_name
from fvslam_graph.core.validation import complaint
from fvslam_graph.core.yaml_files import read_yaml_mapping
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.jobs import VARIANT_SEPARATOR, Job, Source


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) < len(values):
        raise ValueError("something is listed twice")
    return values


def _sources(values: Any) -> Any:
    """A sequence of which only the path is given may be written as that path."""
    if not isinstance(values, list):
        return values
    return [{"path": value} if isinstance(value, str) else value for value in values]


def _distinct_names(sources: tuple[Source, ...]) -> tuple[Source, ...]:
    if len({source.label for source in sources}) < len(sources):
        raise ValueError("two have the same name; give each a name of its own")
    return sources


def _numbers(value: Any) -> Any:
    """A number of seeds means 0, 1, ... below it."""
    return range(value) if isinstance(value, int) else value


class Study(BaseModel):
    """A grid: every sequence x mode x preset x combination of settings x seed is a run.

    Attributes:
        name: Title of the report.
        sequences: Paths, or groups of what `Source` has: path, name, frames, stride, scale, camera_height, topic, ...
        modes: Of the estimator.
        presets: "paper", "tuned" or both.
        settings: Values to try by setting, such as {"fusion.weight": [0.3, 0.5]}; a single value holds for all runs.
        seeds: How many, or which.
        align: How estimates are brought into the world of the ground truth.
        external: Trajectories of other systems by the name of their sequence: files by the name of the system, as for
            `external_run`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = "study"
    sequences: Annotated[
        tuple[Source, ...], BeforeValidator(_sources), AfterValidator(_distinct_names), Field(min_length=1)
    ]
    modes: Annotated[tuple[Mode, ...], AfterValidator(_distinct), Field(min_length=1)] = tuple(Mode)
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

    @model_validator(mode="after")
    def _external_is_of_sequences(self) -> Self:
        labels = [source.label for source in self.sequences]
        for name in self.external:
            if name not in labels:
                raise ValueError(f"external: '{name}' is none of the sequences {', '.join(labels)}")
        return self

    def below(self, folder: Path) -> Self:
        """The same study where its relative paths are those of this folder: absolute, they mean the same anywhere."""

        def absolute(path: str) -> str:
            return path if path.startswith("synthetic:") else str(folder.absolute() / Path(path).expanduser())

        sequences = tuple(source.model_copy(update={"path": absolute(source.path)}) for source in self.sequences)
        external = {
            sequence: {name: absolute(path) for name, path in files.items()}
            for sequence, files in self.external.items()
        }
        return self.model_copy(update={"sequences": sequences, "external": external})

    def jobs(self) -> list[Job]:
        """All runs, sequence by sequence; what a mode does not read makes no other runs of it.

        Raises:
            ConfigError: There is no such setting, a value is out of its range, or none of the modes reads it.
        """
        for name in self.settings:
            if not any(mode.reads(name) for mode in self.modes):
                self._checked({name: value} for value in self._values(name))
                raise ConfigError(f"none of the modes {', '.join(self.modes)} reads the setting '{name}'; leave it out")
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

    def _job(self, source: Source, preset: str, combination: dict[str, Any], mode: Mode, seed: int) -> Job:
        read = {name: _setting(name, value) for name, value in combination.items() if mode.reads(name)}
        varied = [setting for name, setting in read.items() if isinstance(self.settings[name], list)]
        config = load_config(preset, settings=[f"mode={mode}", f"seed={seed}", *read.values()])
        return Job(source, config, VARIANT_SEPARATOR.join(varied))


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


def comparison(
    sequence: str | Path | Source,
    modes: Iterable[str],
    seeds: int | Iterable[int],
    preset: str,
    settings: Mapping[str, Any] | None,
    external: Mapping[str, str | Path] | None,
    align: str,
) -> Study:
    """The study of one sequence; the arguments are those of `fvslam_graph.compare`.

    Raises:
        StudyError: A value is not possible.
        ConfigError: A setting is unknown or out of its range.
    """
    try:
        source = sequence if isinstance(sequence, Source) else Source(path=str(sequence))
        study = Study.model_validate(
            {
                "name": f"Comparison on {source.label}",
                "sequences": [source],
                "modes": list(modes),
                "presets": [preset],
                "settings": dict(settings or {}),
                "seeds": seeds if isinstance(seeds, int) else list(seeds),
                "align": align,
                "external": {source.label: {name: str(file) for name, file in external.items()}} if external else {},
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
