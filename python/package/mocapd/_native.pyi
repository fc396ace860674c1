import os
from typing import Any, TypedDict, final, type_check_only

import numpy as np
import numpy.typing as npt

__all__ = [
    "Imported",
    "ObjectStore",
    "RemoteTake",
    "TakeError",
    "TakeFile",
    "check_take",
    "encode",
    "import_motion",
    "importer_version",
    "measure_take",
    "normal_options",
    "repack_take",
]

class TakeError(Exception): ...

@type_check_only
class Parameter(TypedDict):
    group: str
    name: str
    dimensions: list[int]
    values: list[str] | npt.NDArray[Any]

@type_check_only
class AnalogChannelFields(TypedDict):
    name: str
    unit: str
    description: str
    scale: float
    offset: float

@type_check_only
class AnalogFields(TypedDict):
    rate_hz: float
    samples_per_frame: int
    n_samples: int
    channels: list[AnalogChannelFields]
    warnings: list[str]

@type_check_only
class SampledFields(TypedDict):
    rate_hz: float
    samples_per_frame: int
    n_samples: int
    channels: list[AnalogChannelFields]
    number: int
    plates: list[ForcePlateFields]

@type_check_only
class ForcePlateFields(TypedDict):
    number: int
    type: int
    corners_mm: npt.NDArray[np.float64]
    origin_mm: npt.NDArray[np.float64]
    channels: list[int]
    calibration: npt.NDArray[np.float64] | None

@final
class TakeFile:
    def __new__(cls, path: str | os.PathLike[str]) -> TakeFile: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> TakeFile: ...
    @property
    def n_rows(self) -> int: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def finished(self) -> bool: ...
    @property
    def problems(self) -> list[str]: ...
    @property
    def cut_off(self) -> str | None: ...
    def header(self) -> dict[str, Any]: ...
    def labelled(self) -> list[bool]: ...
    def ledger(self) -> dict[str, Any] | None: ...
    def ending(self) -> tuple[str, str] | None: ...
    def events(self) -> list[dict[str, Any]]: ...
    def clock_lines(self) -> list[dict[str, Any]]: ...
    def read_into(
        self, out: npt.NDArray[np.float32], first: int, columns: list[int], threads: int
    ) -> list[str]: ...
    def scan(
        self, columns: list[int], with_knots: bool, threads: int
    ) -> tuple[list[tuple[int, int, int, float, npt.NDArray[np.int64]]], list[str]]: ...
    def times(
        self, first: int, stop: int
    ) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64], npt.NDArray[np.bool_]]: ...
    def lost(self) -> list[tuple[int, int, str]]: ...
    @property
    def closed(self) -> bool: ...
    def close(self) -> None: ...
    def check_open(self) -> None: ...
    def subject(self) -> tuple[str, list[tuple[str, bytes]]] | None: ...
    def parameters(self) -> list[Parameter]: ...
    def analog(self) -> AnalogFields: ...
    def read_analog(self, out: npt.NDArray[np.float64], first: int, channels: list[int]) -> None: ...
    def force_plates(self) -> tuple[list[ForcePlateFields], list[str]]: ...
    def read_loads(self, out: npt.NDArray[np.float64], first: int, plates: list[int]) -> None: ...
    def sampled(self) -> tuple[list[SampledFields], list[str]]: ...
    def sampled_times(self, group: int) -> npt.NDArray[np.float64]: ...
    def read_sampled(self, out: npt.NDArray[np.float32], group: int, first: int, channels: list[int]) -> None: ...
    def bodies(self) -> list[tuple[int, str]]: ...
    def read_poses(
        self, out: npt.NDArray[np.float32], states: npt.NDArray[np.uint8], first: int, bodies: list[int]
    ) -> None: ...
    def read_sampled_loads(self, out: npt.NDArray[np.float64], group: int, first: int, plates: list[int]) -> None: ...

@type_check_only
class EncodeOptions(TypedDict):
    rate_hz: float
    tolerance_mm: float | None
    resampler: str
    up_axis: int

def encode(
    positions: npt.NDArray[np.float32], labels: list[tuple[str, bool]], options: EncodeOptions, threads: int
) -> bytes: ...

@type_check_only
class ImportOptions(TypedDict):
    format: str
    tolerance_mm: float | None
    resampler: str
    effort: int
    keys_s: float | None
    unit: str | None
    up: str | None
    analog_tolerance: list[str]
    drop_foreign: bool
    subject: str | None

@final
class Imported:
    take: bytes
    max_error_mm: float
    samples: npt.NDArray[np.uint64]
    gaps: npt.NDArray[np.uint64]
    low_mm: npt.NDArray[np.float32]
    high_mm: npt.NDArray[np.float32]
    peak_speed_mm_per_s: npt.NDArray[np.float64]

def importer_version() -> int: ...
def import_motion(data: bytes, options: ImportOptions) -> Imported: ...
def measure_take(data: bytes) -> tuple[Imported, list[str]]: ...
def normal_options(options: ImportOptions) -> tuple[str, str | None, str | None, list[str]]: ...
def check_take(data: bytes) -> list[str]: ...
def repack_take(data: bytes) -> bytes | None: ...

@final
class ObjectStore:
    def __new__(cls, url: str) -> ObjectStore: ...
    def create(self, name: str, data: bytes) -> bool: ...
    def read(self, name: str, start: int = 0, stop: int | None = None) -> bytes: ...
    def size(self, name: str) -> int | None: ...
    def list(self, folder: str) -> list[tuple[str, int, float | None]]: ...
    def remove(self, name: str) -> None: ...
    def open_take(self, name: str) -> RemoteTake: ...
    def traffic(self) -> tuple[int, int, int]: ...

@final
class RemoteTake:
    @property
    def n_rows(self) -> int: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def labels(self) -> list[str]: ...
    def read_into(self, out: npt.NDArray[np.float32], first: int, columns: list[int]) -> list[str]: ...
