"""The captured subject of a take."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from ._native import TakeError


@dataclass(frozen=True)
class Subject:
    """The captured person or object."""

    name: str
    """May be empty."""
    documents: dict[str, bytes]
    """Documents about the subject by their kind, as they were stored: ``skeleton``, ``face``, ``face-markers``."""
    path: str = field(repr=False, compare=False)
    """The take."""

    @property
    def skeleton(self) -> dict[str, Any] | None:
        """The object of ``skeleton.json`` (docs/subject-body-format.md): joints, bones, stature. None without one.

        Raises
        ------
        TakeError
            If the document is not a JSON object.
        """
        return self._object("skeleton")

    @property
    def face(self) -> dict[str, Any] | None:
        """The object of ``face.json`` (docs/subject-face-format.md): the wireframe. None without one.

        Raises
        ------
        TakeError
            If the document is not a JSON object.
        """
        return self._object("face")

    @property
    def face_markers(self) -> dict[str, Any] | None:
        """The object that assigns markers to the face's vertices (docs/subject-face-format.md). None without one.

        Raises
        ------
        TakeError
            If the document is not a JSON object.
        """
        return self._object("face-markers")

    def _object(self, kind: str) -> dict[str, Any] | None:
        if kind not in self.documents:
            return None
        try:
            found = json.loads(self.documents[kind])
        except ValueError as error:
            raise TakeError(f"{self.path}: the subject's {kind} is not JSON: {error}") from error
        if not isinstance(found, dict):
            raise TakeError(f"{self.path}: the subject's {kind} is not a JSON object but {type(found).__name__}")
        return found

    @classmethod
    def _of(cls, found: tuple[str, list[tuple[str, bytes]]] | None, path: str) -> Subject | None:
        return None if found is None else cls(found[0], dict(found[1]), path)
