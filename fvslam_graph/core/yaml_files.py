"""Reading YAML that people hand over: whatever is wrong with it is one sentence."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.text_files import read_text

MAX_YAML_SIZE = 1_000_000  # bytes


class _Loader(yaml.SafeLoader):
    """Plain data and OpenCV's matrices, which become mappings with a key `data`.

    Aliases are refused: a few lines of them stand for gigabytes, or for a list within itself. So are keys given twice.
    Dates stay text, since there are impossible ones.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, f"the alias '*{event.anchor}' is not read", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        mapping = super().construct_mapping(node, deep=deep)
        names = [key.value for key, _ in node.value]
        if len(mapping) < len(names):
            twice = next(name for number, name in enumerate(names) if name in names[:number])
            raise yaml.constructor.ConstructorError(None, None, f"'{twice}' is given twice", node.start_mark)
        return mapping


def _matrix(loader: _Loader, _kind: str, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


def _integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    value = loader.construct_yaml_int(node)
    if abs(value) >= 2**63:
        raise ValueError(f"'{node.value[:20]}...' is too large a number")
    return value


_Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", _matrix)  # -matrix, and -nd-matrix since OpenCV 5
_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def parse_yaml(text: str, name: str, error: type[FvslamError]) -> Any:
    """The value of one YAML document.

    Args:
        text: The document.
        name: What it is, for the message.
        error: What is raised where it is not valid.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark
        where = f" in line {mark.line + 1}" if mark is not None and "\n" in text else ""
        reason = ", ".join(part for part in (problem.context, problem.problem) if part) + where
    except RecursionError:
        reason = "it is nested too deeply"
    except Exception as problem:  # what is raised at a value that does not fit its tag has no common base
        reason = " ".join(str(problem).split())
    raise error(f"{name} is not valid YAML: {reason}")


def read_yaml_mapping(path: Path, error: type[FvslamError]) -> dict[str, Any]:
    """The mapping of a YAML file.

    OpenCV's first line `%YAML:1.0`, which is not the directive that the standard asks for, and the separator that
    `rostopic echo` ends with are left out.

    Raises:
        error: The file cannot be read or holds no mapping.
    """
    lines = [line for line in read_text(path, error, MAX_YAML_SIZE).splitlines() if not line.startswith("%")]
    content = parse_yaml("\n".join(lines).rstrip().removesuffix("\n---"), str(path), error)
    if not isinstance(content, dict):
        raise error(f"{path} is not a YAML file of the form 'key: value'")
    return {str(key): value for key, value in content.items()}
