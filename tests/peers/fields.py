"""Images and displacement fields as arrays with index order x, y, z; positions are LPS mm."""
import csv

import numpy as np
import SimpleITK as sitk
from scipy import ndimage


class Image:
    def __init__(self, source):
        """A file, or an image of SimpleITK."""
        image = sitk.ReadImage(source) if isinstance(source, str) else source
        array = sitk.GetArrayFromImage(image)
        self.values = np.ascontiguousarray(array.transpose(2, 1, 0, *range(3, array.ndim)))
        self.origin = np.array(image.GetOrigin())
        self.spacing = np.array(image.GetSpacing())
        self.step = np.array(image.GetDirection()).reshape(3, 3) * self.spacing
        self.size = self.values.shape[:3]

    def index(self, points):
        """Where points (n x 3) lie in voxels."""
        return np.linalg.solve(self.step, (points - self.origin).T).T

    def world(self, index):
        return index @ self.step.T + self.origin

    def holds(self, points):
        """Which points lie between the outermost voxel centres."""
        at = self.index(points)
        return np.all((at >= 0) & (at <= np.array(self.size) - 1), axis=1)

    def at(self, points, order=1, outside=None):
        """Values at points; beyond the grid those of its border, or a given one."""
        beyond = {"mode": "nearest"} if outside is None else {"mode": "constant", "cval": outside}
        at = self.index(points).T
        if self.values.ndim == 3:
            return ndimage.map_coordinates(self.values, at, order=order, **beyond)
        parts = [ndimage.map_coordinates(self.values[..., c], at, order=order, **beyond) for c in range(self.values.shape[3])]
        return np.stack(parts, -1)


def like(image, values):
    """An array (index order x, y, z) as an image on the grid of another, both of SimpleITK."""
    found = sitk.GetImageFromArray(values.transpose(2, 1, 0))
    found.CopyInformation(image)
    return found


def write_like(image, values, file):
    """Writes it."""
    sitk.WriteImage(like(image, values), file)


class Field(Image):
    """A displacement field: its grid's points x go to x + u(x)."""

    def __init__(self, file):
        super().__init__(sitk.ReadImage(file, sitk.sitkVectorFloat32) if isinstance(file, str) else file)

    def map(self, points):
        return points + self.at(points)


def patient(hu):
    """The patient in a CT: the largest piece above -350 HU, cavities of each slice filled."""
    body = ndimage.binary_opening(hu > -350, iterations=2)
    part, _ = ndimage.label(body)
    body = part == np.argmax(np.bincount(part[part > 0]))
    return np.stack([ndimage.binary_fill_holes(body[:, :, k]) for k in range(body.shape[2])], -1)


def read_landmarks(file, without=()):
    """Points of both scans in a CSV as `aventail register --landmarks` takes it, some left out by name: two arrays of n x 3."""
    with open(file, encoding="utf-8") as text:
        rows = [row for row in csv.DictReader(text) if row.get("name") not in without]
    return [np.array([[float(r[f"{side}_{a}"]) for a in "xyz"] for r in rows]) for side in ("planning", "fraction")]
