"""Order, frame and geometry against SimpleITK and nibabel, on a grid that is oblique and anisotropic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aventail

sitk = pytest.importorskip("SimpleITK")
nibabel = pytest.importorskip("nibabel")


def turned() -> np.ndarray:
    """Axes that are turned about two of them."""
    a, b = 0.3, -0.2
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return about_z @ about_x


def image(values: np.ndarray | None = None) -> aventail.Image:
    array = np.arange(5 * 4 * 3, dtype=np.float32).reshape(5, 4, 3) if values is None else values
    return aventail.Image(array, (1.5, 0.75, 3.0), (-40.0, 25.5, 300.0), turned())


def test_an_index_lies_where_simpleitk_has_it() -> None:
    own, other = image(), image().to_sitk()
    assert own.size == other.GetSize() == (3, 4, 5)
    for index in [(0, 0, 0), (2, 1, 4), (1, 3, 2)]:
        assert np.allclose(own.point(index), other.TransformIndexToPhysicalPoint(index), atol=1e-9)
        x, y, z = index
        assert own.array[z, y, x] == other[index]


def test_simpleitk_and_nibabel_come_back() -> None:
    own = image()
    for other in (own.to_sitk(), own.to_nibabel()):
        back = aventail.Image.of(other)
        assert np.array_equal(back.array, own.array)
        assert np.allclose(back.affine, own.affine, atol=1e-5)


def test_an_image_outlives_the_simpleitk_image_that_it_is_made_of() -> None:
    made = aventail.Image.of(image().to_sitk())
    # Fresh memory, filled with something else.
    others = [sitk.Image([3, 4, 5], sitk.sitkFloat32) + 7.0 for _ in range(50)]
    assert len(others) == 50 and np.array_equal(made.array, image().array)
    assert made.array.flags.owndata


@pytest.mark.parametrize("extension", ["nii.gz", "mha", "nrrd"])
def test_files_are_those_of_simpleitk(tmp_path: Path, extension: str) -> None:
    own = image()
    mine, theirs = tmp_path / f"mine.{extension}", tmp_path / f"theirs.{extension}"
    own.save(mine)
    sitk.WriteImage(own.to_sitk(), str(theirs))
    read = sitk.ReadImage(str(mine))
    assert np.array_equal(sitk.GetArrayFromImage(read), own.array)
    assert np.allclose(read.TransformIndexToPhysicalPoint((2, 1, 4)), own.point((2, 1, 4)), atol=1e-4)
    back = aventail.Image.of(theirs)
    assert np.array_equal(back.array, own.array)
    assert np.allclose(back.affine, own.affine, atol=1e-4)


def test_labels_keep_their_names_in_files_and_in_nibabel(tmp_path: Path) -> None:
    labels = aventail.Image(np.array([[[0, 7]]], np.uint16), names={7: "skull & <co>"}, kind="labels")
    labels.save(tmp_path / "labels.nii.gz")
    assert aventail.Image.of(tmp_path / "labels.nii.gz", "labels").names == {7: "skull & <co>"}
    assert aventail.Image.of(nibabel.load(tmp_path / "labels.nii.gz"), "labels").names == {7: "skull & <co>"}


def test_a_field_is_simpleitks_transform() -> None:
    own = image()
    random = np.random.default_rng(1)
    vectors = random.normal(0, 0.5, (5, 4, 3, 3)).astype(np.float32)
    field = aventail.Field(aventail.Image(vectors, own.spacing, own.origin, own.direction), "planning", "fraction")
    transform = field.to_sitk()
    for index in [(0, 0, 0), (2, 1, 4), (1, 3, 2)]:
        x, y, z = index
        point = own.point(index)
        assert np.allclose(transform.TransformPoint(point), point + vectors[z, y, x], atol=1e-5)


@pytest.mark.parametrize("extension", ["nii.gz", "mha", "nrrd"])
def test_a_saved_field_is_simpleitks_and_comes_back(tmp_path: Path, extension: str) -> None:
    own = image()
    vectors = np.random.default_rng(2).normal(0, 3, (5, 4, 3, 3)).astype(np.float32)
    field = aventail.Field(aventail.Image(vectors, own.spacing, own.origin, own.direction), "planning", "fraction")
    path = tmp_path / f"field.{extension}"
    field.save(path)
    read = sitk.ReadImage(str(path))
    assert np.array_equal(sitk.GetArrayFromImage(read), vectors)
    back = aventail.Field.of(path, "a", "b")
    assert (back.start, back.end) == ("planning", "fraction")
    assert np.array_equal(back.array, vectors)
    assert np.allclose(back.image.affine, own.affine, atol=1e-4)


def test_arrays_of_any_layout_are_taken_as_they_are_indexed(tmp_path: Path) -> None:
    values = np.asfortranarray(np.arange(60, dtype=np.float64).reshape(5, 4, 3))[:, ::-1]
    image(values).save(tmp_path / "odd.nrrd")
    assert np.array_equal(aventail.Image.of(tmp_path / "odd.nrrd").array, values)
