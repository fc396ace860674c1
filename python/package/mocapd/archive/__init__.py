"""Archives of takes: imported on a Ray cluster, stored once each, listed in a Delta table, read by the window.

>>> from mocapd.archive import catalogue, ingest, windows
>>> ingest("c3d/", "archive/", tolerance="0.5mm")
>>> takes = catalogue("archive/").sql("select * from takes where rate_hz >= 100 and seconds > 2")
>>> for batch in windows(takes, seconds=1, hz=50, markers=["LKNE", "RKNE"], bucket="archive/").torch():
...     batch["positions"], batch["valid"]

``docs/archive.md`` describes the bucket, the table, and what happens when something fails.
"""

try:
    import deltalake as _deltalake  # noqa: F401
    import pyarrow as _pyarrow  # noqa: F401
    import tqdm as _tqdm  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"mocapd.archive needs the package {error.name}: pip install './python[archive]' installs all that it needs"
    ) from error

from ._catalogue import Catalogue, catalogue
from ._ingest import IngestReport, ingest
from ._keys import IMPORTER_VERSION, Settings, content_key, object_name, source_hash
from ._schema import SCHEMA
from ._store import BucketStore, Entry, FolderStore, Store, StoreError, open_store
from ._upkeep import RepackReport, VerifyReport, collect, repack, verify
from ._windows import Form, Places, Windows, windows

__all__ = [
    "BucketStore",
    "Catalogue",
    "Entry",
    "FolderStore",
    "Form",
    "IMPORTER_VERSION",
    "IngestReport",
    "Places",
    "RepackReport",
    "SCHEMA",
    "Settings",
    "Store",
    "StoreError",
    "VerifyReport",
    "Windows",
    "catalogue",
    "collect",
    "content_key",
    "ingest",
    "object_name",
    "open_store",
    "repack",
    "source_hash",
    "verify",
    "windows",
]
