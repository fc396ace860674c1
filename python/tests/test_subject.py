"""The subject of a take: name, skeleton and face."""

import json

import numpy as np
import pytest

import mocapd
from c3d_files import c3d_file, walk
from conftest import run

SKELETON = {
    "format": "mocapd-skeleton",
    "version": 1,
    "joints": [{"name": "l_hip"}, {"name": "l_knee"}, {"name": "l_ankle"}],
    "bones": [
        {"name": "l_thigh", "parent": "l_hip", "child": "l_knee", "length_mm": 412},
        {"name": "l_shank", "parent": "l_knee", "child": "l_ankle", "length_mm": 398.5},
    ],
}
FACE = {"format": "mocapd-face", "version": 1, "vertices_mm": [[0, 0, 0], [1, 2, 3]], "lines": [[0, 1]]}


def with_subject(program, folder):
    """A take of Anna, with a skeleton and a face."""
    (folder / "walk.c3d").write_bytes(c3d_file(walk(40), np.zeros((40, 0)), 1, b""))
    (folder / "skeleton.json").write_text(json.dumps(SKELETON))
    (folder / "face.json").write_text(json.dumps(FACE))
    documents = ["--skeleton", folder / "skeleton.json", "--face", folder / "face.json"]
    run(program, "import", folder / "walk.c3d", "-o", folder / "walk.take", "--subject", "Anna", *documents)
    return mocapd.open(folder / "walk.take")


def test_documents_are_objects(program, tmp_path):
    subject = with_subject(program, tmp_path).subject
    assert subject.name == "Anna" and set(subject.documents) == {"skeleton", "face"}
    assert subject.skeleton == SKELETON and subject.face == FACE and subject.face_markers is None
    assert json.loads(subject.documents["face"]) == FACE
    assert "Anna" in repr(subject)


def test_a_document_that_is_no_object_is_a_take_error(tmp_path):
    subject = mocapd.Subject("Anna", {"skeleton": b"{", "face": b"[1]"}, "walk.take")
    with pytest.raises(mocapd.TakeError, match="walk.take.*skeleton is not JSON"):
        subject.skeleton
    with pytest.raises(mocapd.TakeError, match="walk.take.*face is not a JSON object"):
        subject.face
