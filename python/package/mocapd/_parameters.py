"""The parameters of an imported C3D file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Union

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from ._native import Parameter

ParameterValue = Union[str, list[str], int, float, npt.NDArray[Any]]
Metadata = dict[str, dict[str, ParameterValue]]

# By the type code of a parameter (docs/foreign.md): bytes, 16-bit integers, floats.
_TYPES = {1: "u1", 2: "<i2", 4: "<f4"}


def metadata(parameters: list[Parameter]) -> Metadata:
    """The parameters by group and name, both in upper case; the first of a name counts."""
    found: Metadata = {}
    for parameter in parameters:
        group = found.setdefault(parameter["group"].upper(), {})
        group.setdefault(parameter["name"].upper(), _value(parameter))
    return found


def _value(parameter: Parameter) -> ParameterValue:
    dimensions = parameter["dimensions"]
    texts = parameter["texts"]
    if texts is not None:
        # The first dimension is the length of a text.
        return texts if len(dimensions) > 1 else "".join(texts)
    values = np.frombuffer(parameter["data"], dtype=_TYPES[parameter["kind"]])
    if not dimensions:
        return values[0].item() if values.size else values.copy()
    # The first dimension is the fastest.
    return values.reshape(dimensions, order="F").copy()
