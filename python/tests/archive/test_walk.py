"""The Python of docs/archive.md, as it is written there."""

import re
from pathlib import Path

import pytest

archive = pytest.importorskip("mocapd.archive")

from made import write_c3ds  # noqa: E402

PAGE = Path(__file__).parents[3] / "docs" / "archive.md"


@pytest.mark.parametrize("bucket", ["archive/", "s3://takes-test/walk/"])
def test_the_walk(bucket, tmp_path, monkeypatch, capsys, request):
    if bucket.startswith("s3://"):
        request.getfixturevalue("endpoint")
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text().replace("archive/", bucket), re.DOTALL)
    assert len(blocks) == 3
    lines = [line for line in blocks[0].splitlines() if line]
    assert len(lines) == 9, "the page promises ten lines at most"
    monkeypatch.chdir(tmp_path)
    write_c3ds(tmp_path / "c3d", 4, frames=200)
    monkeypatch.setattr(archive, "ingest", in_this_process(archive.ingest))
    exec(blocks[0].replace("LKNE", "M0").replace("RKNE", "M2"), {})
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 3 and all("(16, 25, 2, 3)" in line for line in printed)
    for block in blocks[1:]:
        exec(block, {})
    rows = archive.catalogue(bucket).arrow().to_pylist()
    # The last block retires an importer that had no successor.
    assert len(rows) == 4


def in_this_process(ingest):
    return lambda *args, **options: ingest(*args, **options, workers=0, progress=False)
