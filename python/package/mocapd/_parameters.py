"""The parameters of an imported C3D file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Union

import numpy.typing as npt

if TYPE_CHECKING:
    from ._native import Parameter

ParameterValue = Union[str, list[str], int, float, npt.NDArray[Any]]
Metadata = dict[str, dict[str, ParameterValue]]


def metadata(parameters: list[Parameter]) -> Metadata:
    """The parameters by group and name, both in upper case; the first of a name counts."""
    found: Metadata = {}
    for parameter in parameters:
        group = found.setdefault(parameter["group"].upper(), {})
        group.setdefault(parameter["name"].upper(), _value(parameter))
    return found


def _value(parameter: Parameter) -> ParameterValue:
    dimensions, values = parameter["dimensions"], parameter["values"]
    if isinstance(values, list):
        # The first dimension is the length of a text.
        return values if len(dimensions) > 1 else "".join(values)
    if not dimensions and values.size == 1:
        value: int | float = values[0].item()
        return value
    return values.reshape(dimensions, order="F")
