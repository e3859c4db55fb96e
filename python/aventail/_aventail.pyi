"""The compiled module. What users call is in the package; this is what the package calls."""

from collections.abc import Callable
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Phantom",
    "Registration",
    "__version__",
    "compare_doses",
    "dvh",
    "evaluate",
    "fit_postures",
    "main",
    "make_library",
    "map_dose",
    "pose",
    "read_contours",
    "read_field",
    "read_grid",
    "read_image",
    "read_labels",
    "register",
    "skeleton",
    "summary",
    "write_contours",
    "write_dicom_contours",
    "write_dicom_dose",
    "write_dicom_field",
    "write_dicom_image",
    "write_field",
    "write_image",
    "write_labels",
]

__version__: str

_Vector: TypeAlias = tuple[float, float, float]
_Raster: TypeAlias = tuple[NDArray[Any], _Vector, _Vector, tuple[float, ...]]
"""Array [z, y, x(, component)], spacing, origin, direction row by row."""
_Geometry: TypeAlias = tuple[tuple[int, int, int], _Vector, _Vector, tuple[float, ...]]
"""Size (x, y, z), spacing, origin, direction row by row."""
_Source: TypeAlias = str | _Raster
_Names: TypeAlias = dict[int, str]
_Rows: TypeAlias = list[list[float]]
_Reporter: TypeAlias = Callable[[str, float | None], object] | None

def main(arguments: list[str]) -> int: ...
def read_image(path: str, dose: bool) -> _Raster: ...
def read_labels(path: str) -> tuple[_Raster, _Names]: ...
def read_field(path: str) -> tuple[_Raster, tuple[str, str] | None]: ...
def read_grid(path: str) -> _Geometry: ...
def read_contours(path: str) -> str: ...
def write_image(path: str, raster: _Raster, whole: bool) -> None: ...
def write_labels(path: str, raster: _Raster, names: _Names) -> None: ...
def write_field(path: str, raster: _Raster, frames: tuple[str, str], format: str | None) -> None: ...
def write_contours(path: str, json: str, frame: str) -> None: ...
def write_dicom_image(path: str, raster: _Raster, like: str, of: str | None) -> None: ...
def write_dicom_dose(
    path: str, raster: _Raster, like: str, of: list[str], fields: list[str]
) -> list[tuple[str, str]]: ...
def write_dicom_contours(path: str, json: str, like: str, of: str | None) -> None: ...
def write_dicom_field(path: str, raster: _Raster, start: str, end: str) -> None: ...
def register(
    planning: _Source,
    bones: _Source,
    fractions: list[tuple[_Source, Any]],
    more: dict[str, Any],
    settings: dict[str, Any],
    threads: int,
    progress: _Reporter,
) -> list[Registration]: ...
def pose(
    planning: _Source,
    bones: _Source,
    motion: dict[str, Any],
    margin_mm: float,
    more: dict[str, Any],
    settings: dict[str, Any],
    threads: int,
    progress: _Reporter,
) -> Registration: ...
def evaluate(
    push: _Source | None,
    pull: _Source | None,
    measured: dict[str, Any],
    settings: dict[str, Any],
    threads: int,
    progress: _Reporter,
) -> str: ...
def map_dose(
    dose: _Source,
    push: _Source | None,
    pull: _Source | None,
    to_fraction: bool,
    grid: _Geometry | None,
    parts: int | None,
    ct: _Source | None,
    threads: int,
    progress: _Reporter,
) -> tuple[_Raster, str]: ...
def dvh(
    dose: _Source,
    labels: _Source | None,
    names: _Names | str | None,
    contours: str | None,
    contour_file: str | None,
    at: list[float],
    bin: float,
) -> str: ...
def compare_doses(
    dose: _Source, reference: _Source, tolerance: float | None, limit: float
) -> tuple[_Raster, _Raster, str]: ...
def make_library(wanted: dict[str, Any], settings: dict[str, Any], threads: int, progress: _Reporter) -> str: ...
def fit_postures(runs: list[str], out: str) -> str: ...
def skeleton(bones: _Source, names: _Names | str | None) -> tuple[str, str]: ...
def summary(runs: list[str], out: str | None, anonymous: bool) -> str: ...

@final
class Phantom:
    def __new__(cls, json: str, spacing: _Vector | None, second: bool, cbct: bool) -> Phantom: ...
    def planning(self) -> _Raster: ...
    def fraction(self) -> _Raster: ...
    def bones(self) -> tuple[_Raster, _Names]: ...
    def body(self) -> _Raster: ...
    def landmarks(self) -> list[tuple[str, _Vector, _Vector]]: ...
    def transforms(self) -> list[tuple[str, _Rows]]: ...
    def truth(self) -> _Raster: ...
    def plan(self) -> tuple[_Raster, str]: ...

@final
class Registration:
    def report(self) -> str: ...
    def field(self, to_fraction: bool) -> _Raster: ...
    def image(self, name: str) -> _Raster | None: ...
    def labels(self, name: str) -> tuple[_Raster, _Names] | None: ...
    def mask(self, name: str) -> _Raster | None: ...
    def bones(self) -> list[tuple[str, _Rows]]: ...
    def warnings(self) -> list[tuple[str, str]]: ...
    def save(self, folder: str, view: bool, progress: _Reporter) -> None: ...
    def warp_points(self, points: NDArray[np.float64], to_fraction: bool) -> tuple[NDArray[Any], NDArray[Any]]: ...
    def warp_image(
        self, image: _Source, to_fraction: bool, cubic: bool, outside: float, dose: bool, grid: _Geometry | None
    ) -> _Raster: ...
    def warp_labels(
        self, labels: _Source, names: _Names | None, to_fraction: bool, grid: _Geometry | None
    ) -> tuple[_Raster, _Names]: ...
    def warp_contours(self, json: str, to_fraction: bool, grid: _Geometry | None) -> str: ...
