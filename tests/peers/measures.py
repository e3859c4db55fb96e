"""What can be measured of a registration between two scans without truth. Positions and distances are in mm."""
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

# Grey values, HU: of bone surfaces, of the skin, and of what counts as air and as tissue.
BONE, SKIN, AIR, TISSUE = 350.0, -350.0, -500.0, -200.0
# How far a surface's nearest points may lie for their planes to be measured against, mm.
PLANE = 2.0


def surface(image, level, across):
    """Points where grey values cross a level between neighbouring voxels, and unit normals towards lower values.

    `across(low, high, axis)` chooses among pairs of neighbours by the slices of both.
    """
    values = image.values.astype(np.float32)
    found = []
    for axis in range(3):
        low, high = ([slice(None)] * 3 for _ in range(2))
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        low, high = tuple(low), tuple(high)
        a, b = values[low], values[high]
        at = np.argwhere(((a >= level) != (b >= level)) & across(low, high))
        start, end = a[tuple(at.T)], b[tuple(at.T)]
        at = at.astype(float)
        at[:, axis] += (level - start) / (end - start)
        found.append(at)
    at = np.concatenate(found)
    slope = np.stack([ndimage.map_coordinates(g, at.T, order=1) for g in np.gradient(values)], -1) @ np.linalg.inv(image.step)
    return image.world(at), -slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-6)[:, None]


class Surface:
    """A surface to measure distances to."""

    def __init__(self, points, normals):
        self.points, self.normals, self.tree = points, normals, cKDTree(points)

    def nearest(self, points, normals):
        """For each point: the nearest of the surface that faces the same way, its normal, and the distance to it."""
        distance, which = self.tree.query(points, k=8)
        same = (self.normals[which] * normals[:, None]).sum(-1) > 0.5
        first = np.where(same.any(1), same.argmax(1), 0)
        row = np.arange(len(points))
        return self.points[which[row, first]], self.normals[which[row, first]], distance[row, first]

    def offset(self, points, normals):
        """Signed distance along the surface's normal, positive outside."""
        there, normal, distance = self.nearest(points, normals)
        along = ((points - there) * normal).sum(1)
        return np.where(distance < PLANE, along, np.sign(along) * distance)

    def move_left(self, points, normals, rounds=30):
        """How far a rigid fit of its own would still move some points, in the mean: point to plane, the nearer 80 %."""
        if len(points) > 4000:
            chosen = np.random.default_rng(1).choice(len(points), 4000, replace=False)
            points, normals = points[chosen], normals[chosen]
        middle, moved = points.mean(0), points
        for _ in range(rounds):
            there, normal, distance = self.nearest(moved, normals)
            near = distance <= np.quantile(distance, 0.8)
            arm = moved[near] - middle
            rows = np.c_[np.cross(arm, normal[near]), normal[near]]
            miss = ((there - moved)[near] * normal[near]).sum(1)
            # Turns count as the shift that they make at the points; a hundredth holds what nothing determines.
            scale = np.r_[np.full(3, np.sqrt((arm**2).sum(1).mean())), np.ones(3)]
            rows /= scale
            step = np.linalg.solve(rows.T @ rows + 0.01 * len(rows) * np.eye(6) / 6, rows.T @ miss) / scale
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            moved = (moved - middle) @ turn.T + middle + step[3:]
            normals = normals @ turn.T
        return float(np.linalg.norm(moved - points, axis=1).mean())


def bone_surface(image, inside):
    """Of the bone whose voxels are marked."""
    return surface(image, BONE, lambda low, high: inside[low] | inside[high])


def skin(image, patient):
    return surface(image, SKIN, lambda low, high: patient[low] != patient[high])


def summary(values):
    values = np.asarray(values)
    if values.size == 0:
        return {"n": 0}
    return {"n": int(values.size), "mean": float(values.mean()), "p95": float(np.percentile(values, 95)), "max": float(values.max())}


def departure(points, moved):
    """How far each of some points has moved from the rigid motion that fits them best."""
    a, b = points - points.mean(0), moved - moved.mean(0)
    turn, _ = Rotation.align_vectors(b, a)
    return np.linalg.norm(turn.apply(a) - b, axis=1)


def shape_change(points, moved):
    """How far from any rigid motion some points have moved, rms."""
    return float(np.sqrt((departure(points, moved) ** 2).mean()))


def local_correlation(a, b, inside, spacing, least, cube=20.0, every=4.0, smooth=1.5):
    """Mean correlation in cubes, where a varies by `least` or more; only what is inside counts. And its volume, ml."""
    size = np.maximum(1, np.round(cube / spacing)).astype(int)
    box = lambda v: ndimage.uniform_filter(v.astype(np.float32), size, mode="constant")
    a, b = (ndimage.gaussian_filter(v.astype(np.float32), smooth / spacing) for v in (a, b))
    share = box(inside)
    mean = lambda v: box(np.where(inside, v, 0)) / np.maximum(share, 1e-6)
    ma, mb = mean(a), mean(b)
    va, vb, ab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    step = np.maximum(1, np.round(every / spacing)).astype(int)
    places = np.zeros(a.shape, bool)
    places[:: step[0], :: step[1], :: step[2]] = True
    places &= inside & (share > 0.25) & (va > least**2) & (vb > 5.0**2)
    found = ab[places] / np.sqrt(va[places] * vb[places])
    return float(found.mean()), float(places.sum() * np.prod(spacing * step) / 1000)


def came_and_went(planning, warped, patient, seen, spacing):
    """Voxels of tissue where planning has air and the other way, at least three voxels thick: inside and at the skin."""
    near = ndimage.distance_transform_edt(~patient, spacing) < 20
    deep = ndimage.distance_transform_edt(patient, spacing) > 5
    came = ndimage.binary_opening((planning < AIR) & (warped > TISSUE) & near & seen)
    went = ndimage.binary_opening((planning > TISSUE) & (warped < AIR) & near & seen)
    return {f"{name}_{where}": change & place
            for name, change in (("came", came), ("went", went)) for where, place in (("inside", deep), ("skin", ~deep))}  # fmt: skip


def folds(image, moved, patient, bones):
    """Cells of a grid (eight voxel centres) in the patient of which any corner turns over, apart from those between two bones.

    And the 1st percentile of the others' volumes (the mean over their corners) by what they were.
    """
    p = moved.astype(np.float32)
    cell = lambda v, how: how.reduce([v[i : v.shape[0] - 1 + i, j : v.shape[1] - 1 + j, k : v.shape[2] - 1 + k]
                                      for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # fmt: skip
    edge = [np.diff(p, axis=a) for a in range(3)]
    worst, total = None, 0.0
    cut = lambda v, i, a: v[(slice(None),) * a + (slice(i, v.shape[a] - 1 + i),)]
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                x, y, z = cut(cut(edge[0], j, 1), k, 2), cut(cut(edge[1], i, 0), k, 2), cut(cut(edge[2], i, 0), j, 1)
                volume = (
                    x[..., 0] * (y[..., 1] * z[..., 2] - y[..., 2] * z[..., 1])
                    + x[..., 1] * (y[..., 2] * z[..., 0] - y[..., 0] * z[..., 2])
                    + x[..., 2] * (y[..., 0] * z[..., 1] - y[..., 1] * z[..., 0])
                ) / np.linalg.det(image.step)
                worst = volume if worst is None else np.minimum(worst, volume)
                total = total + volume / 8
    inside = cell(patient, np.logical_and)
    most = cell(bones, np.maximum)
    least = cell(np.where(bones == 0, most.max() + 1, bones), np.minimum)
    contact = (most > 0) & (least < most)
    folded = inside & (worst <= 0)
    return {"cells": int(inside.sum()), "folded": int((folded & ~contact).sum()), "folded_between_bones": int((folded & contact).sum()),
            "volume_1st_percentile": float(np.percentile(total[inside & ~contact], 1))}  # fmt: skip


def without_air(hu, patient):
    """The patient without air and what it encloses within three voxels, as the vessels of a lung."""
    return patient & ~ndimage.binary_closing(patient & (hu < AIR), iterations=3)


def target_errors(field, planning, fraction, snap=None):
    """Distances of mapped planning points to the fraction's; `snap`: to the voxel centres of that image first, as DIR-Lab."""
    mapped = field.map(planning)
    if snap is not None:
        mapped = snap.world(np.round(snap.index(mapped)))
    return np.linalg.norm(mapped - fraction, axis=1)
