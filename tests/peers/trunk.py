#!/usr/bin/env python3
"""Another site and another model of motion: poses a trunk CT, registers it with aventail and scores bones and soft tissue.

usage: trunk.py AVENTAIL TRUNK OUT [--pose bend|pelvis] [--seed N] [--limit MM]

AVENTAIL  the aventail program
TRUNK     folder with ct.nii.gz and totalsegmentator.nii.gz (task `total`, label names in the NIfTI header extension)
OUT       gets trunk_case/ (fraction_ct.nii.gz, truth_bones.json, landmarks.csv) and result/
--pose    bend: the spine bends joint by joint, all one way, and the thighs turn in the hips; pelvis: also the hip bones
          turn 5 degrees about the femoral heads, against the sacrum, more than a living sacroiliac joint allows
--seed    of joint angles, couch shift, slices that are cut, soft tissue and noise
--limit   exit code 1 when the mean over the visible bones is above this many mm (default 0.6)

Neither a chain mail nor elasticity made this truth. Bones move exactly rigidly. Soft tissue takes the mean of the bones'
motions in log space (relative to the sacrum), weighted by distance to the power -3.5, and a random smooth motion (1.1 mm
per axis, vanishing at bone) on top. The field is inverted by fixed-point iteration, the CT resampled with cubic splines onto
another grid with fewer slices, then blurred a little by noise: 15 HU noise, HU gain 1.02 and offset -8.
"""
import argparse
import csv
import json
import os
import re
import subprocess
import sys

import nibabel as nib
import numpy as np
import SimpleITK as sitk
from fields import patient
from scipy import ndimage
from scipy.spatial.transform import Rotation

AIR = -1000.0
EXPONENT = 3.5
SPINE = ["sacrum", "vertebrae_S1", *(f"vertebrae_L{n}" for n in (5, 4, 3, 2, 1)), *(f"vertebrae_T{n}" for n in (12, 11))]
# Greatest angle (degrees) of a spinal joint about x (right-left), y (front-back), z (up-down).
SPINAL = (3.0, 2.0, 1.0)
# Angle of the thighs about a random axis through the femoral head, and of the hip bones in `pelvis`, degrees.
THIGH, HIP = (5.0, 8.0), 5.0
# Greatest turn (degrees) and shift (mm) of the patient on the couch, and motion of soft tissue on its own (mm rms per axis).
COUCH_TURN, COUCH_SHIFT, OWN_MOTION = 2.5, 20.0, 1.1


class Trunk:
    """CT and bones as arrays with index order x, y, z; positions LPS mm."""

    def __init__(self, folder):
        self.image = sitk.ReadImage(f"{folder}/ct.nii.gz", sitk.sitkFloat32)
        self.hu = array(self.image)
        self.labels = array(sitk.ReadImage(f"{folder}/totalsegmentator.nii.gz"))
        extension = nib.load(f"{folder}/totalsegmentator.nii.gz").header.extensions[0].get_content()
        text = extension.decode() if isinstance(extension, bytes) else str(extension)
        names = {int(k): v for k, v in re.findall(r'Key="(\d+)".*?CDATA\[(.*?)\]', text)}
        self.names = {k: v for k, v in names.items() if (self.labels == k).any()}
        rigid = re.compile("vertebrae_|sacrum|hip_|femur_|rib_")
        self.bones = {v: k for k, v in self.names.items() if rigid.match(v)}
        self.origin = np.array(self.image.GetOrigin())
        self.step = np.array(self.image.GetDirection()).reshape(3, 3) * np.array(self.image.GetSpacing())
        self.x = world(self.hu.shape, self.step, self.origin)
        self.body = patient(self.hu)

    def points(self, bone):
        return self.x[self.labels == self.bones[bone]]

    def head(self, side):
        """Centre of the femoral head: a sphere through the femur's surface that faces the hip bone."""
        femur, hip = (self.labels == self.bones[f"{b}_{side}"] for b in ("femur", "hip"))
        facing = femur & ~ndimage.binary_erosion(femur) & (ndimage.distance_transform_edt(~hip, np.abs(np.diag(self.step))) < 8)
        p = self.x[facing]
        middle = p.mean(0)
        a = np.c_[2 * (p - middle), np.ones(len(p))]
        return middle + np.linalg.lstsq(a, ((p - middle) ** 2).sum(1), rcond=None)[0][:3]

    def disc(self, upper, lower):
        """Between two vertebral bodies: the part of a vertebra in front of the spinal cord."""
        cord = next(k for k, v in self.names.items() if v == "spinal_cord")
        front = self.x[self.labels == cord][:, 1].mean() - 12.0
        body = lambda b: (lambda p: p[p[:, 1] < front] if (p[:, 1] < front).sum() > 30 else p)(self.points(b)).mean(0)
        return (body(upper) + body(lower)) / 2


def array(image):
    return np.ascontiguousarray(sitk.GetArrayFromImage(image).transpose(2, 1, 0))


def world(shape, step, origin):
    return np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij"), -1) @ step.T + origin


def about(centre, degrees, shift=(0, 0, 0)):
    t = np.eye(4)
    t[:3, :3] = Rotation.from_rotvec(degrees, degrees=True).as_matrix()
    t[:3, 3] = centre - t[:3, :3] @ centre + shift
    return t


def pose(trunk, kind, draw):
    """True 4x4 of each bone, planning to fraction."""
    axis = lambda: (lambda v: v / np.linalg.norm(v))(draw.normal(size=3))
    at = {"sacrum": about(trunk.points("sacrum").mean(0), COUCH_TURN * axis(), draw.uniform(-COUCH_SHIFT, COUCH_SHIFT, 3))}
    at["vertebrae_S1"] = at["sacrum"]
    way = draw.choice([-1.0, 1.0], 3)
    for lower, upper in zip(SPINE[1:], SPINE[2:]):
        at[upper] = at[lower] @ about(trunk.disc(upper, lower), way * draw.uniform(0.2, 1.0, 3) * SPINAL)
    for side in ("left", "right"):
        centre = trunk.head(side)
        hip = about(centre, HIP * axis()) if kind == "pelvis" else np.eye(4)
        at[f"hip_{side}"] = at["sacrum"] @ hip
        at[f"femur_{side}"] = at["sacrum"] @ about(centre, draw.uniform(*THIGH) * axis())
    for bone in trunk.bones:
        if bone.startswith("rib_"):
            carrier = "vertebrae_T12" if bone.endswith("12") else "vertebrae_T11"
            near = trunk.points(bone)
            joint = near[np.argmin(((near - trunk.points(carrier).mean(0)) ** 2).sum(1))]
            at[bone] = at[carrier] @ about(joint, 1.5 * axis())
    return at


def logarithm(t):
    """Twist (rotation vector, translation part) of a rigid motion."""
    w = Rotation.from_matrix(t[:3, :3]).as_rotvec()
    return np.r_[w, np.linalg.solve(left_jacobian(w[None])[0], t[:3, 3])]


def left_jacobian(w):
    angle = np.maximum(np.linalg.norm(w, axis=-1), 1e-9)[..., None, None]
    k = np.zeros((*w.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    k -= np.swapaxes(k, -1, -2)
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * (k @ k)


def motion(trunk, at, draw):
    """True displacement (mm, LPS) at every planning voxel, and each voxel's distance to bone (mm)."""
    root = at["sacrum"]
    shape, spacing = trunk.hu.shape, np.linalg.norm(trunk.step, axis=0)
    total, twist, nearest = np.zeros(shape), np.zeros((*shape, 6)), np.full(shape, np.inf)
    for bone, label in trunk.bones.items():
        d = ndimage.distance_transform_edt(trunk.labels != label, spacing)
        weight = np.maximum(d, 1e-3) ** -EXPONENT
        total += weight
        twist += weight[..., None] * logarithm(np.linalg.inv(root) @ at[bone])
        nearest = np.minimum(nearest, d)
    twist /= total[..., None]
    w = twist[..., :3].reshape(-1, 3)
    x = trunk.x.reshape(-1, 3)
    local = Rotation.from_rotvec(w).apply(x) + np.einsum("nij,nj->ni", left_jacobian(w), twist[..., 3:].reshape(-1, 3))
    noise = draw.normal(size=(3, *shape))
    wave = np.stack([ndimage.gaussian_filter(c, 18.0 / spacing, mode="wrap") for c in noise], -1)
    wave *= OWN_MOTION / wave.std() * (1 - np.exp(-((nearest / 15.0) ** 2)))[..., None]
    u = (local @ root[:3, :3].T + root[:3, 3] - x).reshape(*shape, 3) + wave
    for bone in trunk.bones:
        inside = trunk.labels == trunk.bones[bone]
        p = trunk.x[inside]
        u[inside] = p @ at[bone][:3, :3].T + at[bone][:3, 3] - p
    return u, nearest


def sample(values, step, origin, points, order, outside):
    index = np.moveaxis((points - origin) @ np.linalg.inv(step).T, -1, 0)
    return ndimage.map_coordinates(values, index, order=order, mode="constant", cval=outside)


def field_at(u, trunk, points):
    """The displacement at any point, linear; beyond the planning grid that of its border."""
    index = np.moveaxis((points - trunk.origin) @ np.linalg.inv(trunk.step).T, -1, 0)
    return np.stack([ndimage.map_coordinates(u[..., a], index, order=1, mode="nearest") for a in range(3)], -1)


def deform(trunk, u, draw):
    """The fraction CT."""
    # LPS storage where planning is RAS; off by a part of a voxel; fewer slices below and above.
    spacing = np.array([3.0, 3.0, 3.0])
    low, high = trunk.x.reshape(-1, 3).min(0), trunk.x.reshape(-1, 3).max(0)
    below, above = draw.integers(4, 10, 2)
    origin = low + u[trunk.body].mean(0).round() + draw.uniform(-1.5, 1.5, 3) + [0, 0, 3.0 * below]
    size = np.floor((high - low) / spacing).astype(int) + 1 - [0, 0, below + above]
    y = world(size, np.diag(spacing), origin)
    back = np.zeros_like(y)
    for _ in range(40):
        change = -field_at(u, trunk, y + back) - back
        back += 0.7 * change
    left = np.linalg.norm(change, axis=-1)[sample(trunk.body.astype(float), trunk.step, trunk.origin, y + back, 0, 0.0) > 0]
    print(f"inverse: residual in the body {left.mean():.5f} mm, 99.99th percentile {np.percentile(left, 99.99):.4f}, max {left.max():.4f}")
    hu = sample(trunk.hu, trunk.step, trunk.origin, y + back, 3, AIR)
    hu = 1.02 * hu - 8.0 + draw.normal(scale=15.0, size=hu.shape)
    image = sitk.GetImageFromArray(hu.clip(-1024, 3000).round().astype(np.int16).transpose(2, 1, 0))
    image.SetOrigin(origin.tolist())
    image.SetSpacing(spacing.tolist())
    return image


def make(trunk, kind, seed, out):
    """Writes the case; returns true transforms, displacement and distance to bone."""
    os.makedirs(out, exist_ok=True)
    draw = np.random.default_rng(seed)
    at = pose(trunk, kind, draw)
    u, gap = motion(trunk, at, draw)
    gradient = np.stack([np.stack(np.gradient(u[..., a]), -1) for a in range(3)], -2) @ np.linalg.inv(trunk.step)
    folded = trunk.body & (np.linalg.det(np.eye(3) + gradient) <= 0)
    soft = trunk.body & (gap > 0)
    print(f"truth: soft tissue moves {np.linalg.norm(u[soft], axis=-1).mean():.1f} mm on average, {np.linalg.norm(u[soft] - u[soft].mean(0), axis=-1).mean():.1f} mm "
          f"about the mean motion; {folded.sum()} voxels of the body fold, {(folded & (gap > 3)).sum()} of them away from bone")
    sitk.WriteImage(deform(trunk, u, draw), f"{out}/fraction_ct.nii.gz")
    with open(f"{out}/truth_bones.json", "w") as file:
        json.dump({b: t.tolist() for b, t in at.items()}, file, indent=1)
    with open(f"{out}/landmarks.csv", "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["name", *(f"{s}_{a}" for s in ("planning", "fraction") for a in "xyz")])
        for label, name in trunk.names.items():
            if name not in trunk.bones and (trunk.labels == label).sum() > 400:
                p = trunk.x[trunk.labels == label].mean(0)
                q = p + field_at(u, trunk, p[None])[0]
                rows.writerow([f"centre_{name}", *(f"{v:.3f}" for v in (*p, *q))])
    return at, u, gap


def score(trunk, at, u, gap, case, result):
    """Prints errors in mm of the push field; returns the mean over the visible bones."""
    found = sitk.GetArrayFromImage(sitk.ReadImage(f"{result}/planning_to_fraction.nii.gz")).transpose(2, 1, 0, 3)
    error = np.linalg.norm(found - u, axis=-1)
    view = sitk.ReadImage(f"{case}/fraction_ct.nii.gz")
    low = np.array(view.GetOrigin())
    high = low + (np.array(view.GetSize()) - 1) * np.array(view.GetSpacing())
    seen = np.all((trunk.x + u >= low) & (trunk.x + u <= high), axis=-1)
    with open(f"{result}/report.json") as file:
        fit = {b["name"]: b for b in json.load(file)["bones"]}
    means = []
    print("\n| bone | visible voxels | mean mm | max mm | motion mm | reported sd mm | determined by |\n|---|---|---|---|---|---|---|")
    for bone, label in trunk.bones.items():
        inside = trunk.labels == label
        m = inside & seen
        if m.sum() >= 50:
            means.append(error[m].mean())
        all_mean = f"{error[m].mean():.2f} | {error[m].max():.2f}" if m.any() else "- | -"
        print(f"| {bone} | {m.sum()} of {inside.sum()} | {all_mean} | {np.linalg.norm(u[inside], axis=-1).mean():.1f} | "
              f"{fit[bone]['position_sd_mm']:.2f} | {fit[bone]['determined_by']} |")
    print(f"\nbones with 50 visible voxels or more: {len(means)}, mean {np.mean(means):.3f} mm, worst {np.max(means):.3f} mm")
    soft = trunk.body & seen & (gap > 0)
    for name, m in (("soft tissue", soft), ("soft tissue beyond 10 mm of bone", soft & (gap > 10))):
        e = error[m]
        print(f"{name}: mean {e.mean():.2f} mm, median {np.median(e):.2f}, 95th percentile {np.percentile(e, 95):.2f}, max {e.max():.2f}, "
              f"{e.mean() / np.linalg.norm(u[m], axis=-1).mean():.2f} of the true motion")
    return np.mean(means)


def main():
    parser = argparse.ArgumentParser(description="Poses a trunk CT, registers it with aventail and scores the result.")
    parser.add_argument("aventail")
    parser.add_argument("trunk")
    parser.add_argument("out")
    parser.add_argument("--pose", choices=["bend", "pelvis"], default="bend")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=0.6)
    given = parser.parse_args()
    trunk = Trunk(given.trunk)
    case, result = f"{given.out}/trunk_case", f"{given.out}/result"
    truth = make(trunk, given.pose, given.seed, case)
    command = [given.aventail, "register", "--planning", f"{given.trunk}/ct.nii.gz", "--bones", f"{given.trunk}/totalsegmentator.nii.gz",
               "--fraction", f"{case}/fraction_ct.nii.gz", "--landmarks", f"{case}/landmarks.csv", "--out", result, "--quiet"]
    subprocess.run(command, check=True)
    mean = score(trunk, *truth, case, result)
    return 1 if not mean <= given.limit else 0


if __name__ == "__main__":
    sys.exit(main())
