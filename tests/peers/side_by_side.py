#!/usr/bin/env python3
"""aventail beside image-driven tools on one case, in one run: time and error of each.

usage: side_by_side.py AVENTAIL [CASES] [--case NAME] [--out DIR] [--tools TOOL,TOOL]

TOOL is aventail, fast, plastimatch, elastix, greedy, or one that is told of the planning bones, as structures guide
image-driven registration in clinics: plastimatch-bones (the bones, 3 mm around them included, are registered before
the rest) and elastix-bones (its rigidity penalty on them). The first five by default.

AVENTAIL  the aventail program
CASES     folder with planning_ct.nii.gz, bones.nii.gz, bones.json, NAME/fraction_ct.nii.gz and NAME/truth_points.csv.gz
          (x, y, z of planning in LPS mm, the true displacement, 0 or the bone's label); default: AVENTAIL_CASES

Planning is fixed, the fraction moving, so that each field takes planning points to the fraction. Every tool gets the patient's
mask in planning, that aventail finds, and all threads; its settings are those that a careful user would take, the same for all
cases. The time is the wall time of the program with its files. Errors are at the true points: soft tissue, and the mean of
each bone's. A tool that is not installed is skipped and named. The table goes to the terminal.
"""
import argparse
import gzip
import os
import shutil
import subprocess
import sys
import tempfile
import time

import numpy as np
import SimpleITK as sitk
from scipy import ndimage

ELASTIX = """
(FixedInternalImagePixelType "float") (MovingInternalImagePixelType "float")
(Interpolator "LinearInterpolator") (ResampleInterpolator "FinalBSplineInterpolator")
(FinalBSplineInterpolationOrder 1) (Resampler "DefaultResampler")
(FixedImagePyramid "FixedSmoothingImagePyramid") (MovingImagePyramid "MovingSmoothingImagePyramid")
(Optimizer "AdaptiveStochasticGradientDescent") (NumberOfHistogramBins 32)
(HowToCombineTransforms "Compose") (ErodeMask "false") (ImageSampler "RandomCoordinate")
(NewSamplesEveryIteration "true") (WriteResultImage "false") (ResultImageFormat "mha")
(FixedImageDimension 3) (MovingImageDimension 3)
"""
RIGID = ELASTIX + """
(Registration "MultiResolutionRegistration") (Transform "EulerTransform")
(Metric "AdvancedMattesMutualInformation") (AutomaticTransformInitialization "true")
(AutomaticScalesEstimation "true") (NumberOfResolutions 3) (MaximumNumberOfIterations 250)
(NumberOfSpatialSamples 4000)
"""
BSPLINE = ELASTIX + """
(Registration "MultiMetricMultiResolutionRegistration") (Transform "BSplineTransform")
(Metric "AdvancedMattesMutualInformation" "TransformBendingEnergyPenalty") (Metric0Weight 1.0)
(Metric1Weight 10.0) (FinalGridSpacingInPhysicalUnits 10.0) (NumberOfResolutions 4)
(MaximumNumberOfIterations 500) (NumberOfSpatialSamples 5000)
"""
RIGIDITY = BSPLINE.replace('"TransformBendingEnergyPenalty"', '"TransformRigidityPenalty"').replace(
    "(Metric1Weight 10.0)",
    """(Metric1Weight 1.0) (UseFixedRigidityImage "true") (UseMovingRigidityImage "false")
(FixedRigidityImageName "{rigid}") (LinearityConditionWeight 100.0) (OrthonormalityConditionWeight 1.0)
(PropernessConditionWeight 2.0) (DilateRigidityImages "false")""",
)


def bspline_stage(spacing, shrink):
    """A stage of plastimatch, its heading left out; spacing of the control points in mm."""
    return f"""xform=bspline
optim=lbfgsb
impl=plastimatch
metric=mse
max_its=60
regularization_lambda=0.01
grid_spac={spacing} {spacing} {spacing}
res={shrink}
"""


BONES_FIRST = "[STAGE]\nfixed_roi={bones}\n" + bspline_stage(30, "2 2 1") + "[STAGE]\nfixed_roi={mask}\n"
PLASTIMATCH = """
[GLOBAL]
fixed={fixed}
moving={moving}
fixed_roi={mask}
vf_out={out}/field.mha
default_value=-1000
[STAGE]
xform=rigid
optim=versor
impl=itk
metric=mse
max_its=100
res=4 4 2
"""
for spacing, shrink in ((60, "4 4 2"), (30, "2 2 1"), (15, "1 1 1")):
    PLASTIMATCH += "[STAGE]\n" + bspline_stage(spacing, shrink)


def run(command):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]}: exit {done.returncode}\n{done.stdout[-2000:]}")


def aventail(job, more=()):
    run(
        [job.aventail, "register", "-q", "--planning", job.fixed, "--bones", job.bones, "--labels", job.names]
        + ["--fraction", job.moving, "--out", job.out, *more]
    )
    return f"{job.out}/planning_to_fraction.nii.gz"


def fast(job):
    return aventail(job, ["--speed", "fast"])


def plastimatch(job):
    with open(f"{job.out}/parameters.txt", "w", encoding="utf-8") as file:
        file.write(PLASTIMATCH.format(fixed=job.fixed, moving=job.moving, mask=job.mask, out=job.out))
    run(["plastimatch", "register", f"{job.out}/parameters.txt"])
    return f"{job.out}/field.mha"


def near_bones(job, mm):
    """The planning bones and what lies within some millimetres of them, as an image of 0 and 1."""
    bones = sitk.ReadImage(job.bones) > 0
    distance = sitk.SignedMaurerDistanceMap(bones, insideIsPositive=False, squaredDistance=False, useImageSpacing=True)
    return distance <= mm


def plastimatch_bones(job):
    bones = f"{job.out}/bones.mha"
    sitk.WriteImage(sitk.Cast(near_bones(job, 3.0), sitk.sitkUInt8), bones)
    rigid, first, rest = PLASTIMATCH.partition("[STAGE]\nxform=bspline")
    text = rigid + BONES_FIRST + "xform=bspline" + rest
    assert first
    with open(f"{job.out}/parameters.txt", "w", encoding="utf-8") as file:
        file.write(text.format(fixed=job.fixed, moving=job.moving, mask=job.mask, out=job.out, bones=bones))
    run(["plastimatch", "register", f"{job.out}/parameters.txt"])
    return f"{job.out}/field.mha"


def elastix_bones(job):
    rigid = f"{job.out}/rigidity.mha"
    sitk.WriteImage(sitk.Cast(near_bones(job, 0.0), sitk.sitkFloat32), rigid)
    return elastix(job, RIGIDITY.format(rigid=rigid))


def elastix(job, bspline=BSPLINE):
    for name, text in (("rigid", RIGID), ("bspline", bspline)):
        with open(f"{job.out}/{name}.txt", "w", encoding="utf-8") as file:
            file.write(text.replace(") (", ")\n("))
    run(
        ["elastix", "-f", job.fixed, "-m", job.moving, "-fMask", job.mask, "-out", job.out]
        + ["-p", f"{job.out}/rigid.txt", "-p", f"{job.out}/bspline.txt"]
    )
    run(["transformix", "-def", "all", "-out", job.out, "-tp", f"{job.out}/TransformParameters.1.txt"])
    return f"{job.out}/deformationField.mha"


def greedy(job):
    images = f"-i {job.fixed} {job.moving} -gm {job.mask}"
    for command in (
        f"-d 3 -a -dof 6 {images} -m NMI -ia-image-centers -n 100x50x0 -o {job.out}/rigid.mat",
        f"-d 3 {images} -m NCC 2x2x2 -it {job.out}/rigid.mat -n 100x100x50 -s 2vox 0.5vox -o {job.out}/warp.nii.gz",
        f"-d 3 -rf {job.fixed} -r {job.out}/warp.nii.gz {job.out}/rigid.mat -rc {job.out}/field.nii.gz",
    ):
        # In a process of its own, because the library writes to the terminal.
        run([sys.executable, "-c", f"from picsl_greedy import Greedy3D; Greedy3D().execute({command!r})"])
    return f"{job.out}/field.nii.gz"


TOOLS = {"aventail": aventail, "fast": fast, "plastimatch": plastimatch, "elastix": elastix, "greedy": greedy}
WITH_BONES = {"plastimatch-bones": plastimatch_bones, "elastix-bones": elastix_bones}


def installed(tool):
    if tool == "greedy":
        return subprocess.run([sys.executable, "-c", "import picsl_greedy"], capture_output=True, check=False).returncode == 0
    return tool in ("aventail", "fast") or shutil.which(tool.removesuffix("-bones")) is not None


def true_points(case):
    """Rows of x, y, z, true displacement, label of a case's folder."""
    with gzip.open(f"{case}/truth_points.csv.gz", "rt") as file:
        next(file)
        return np.loadtxt(file, delimiter=",")


def errors(field, truth):
    """Error at each true point, mm."""
    image = sitk.ReadImage(field, sitk.sitkVectorFloat32)
    u = sitk.GetArrayFromImage(image).transpose(2, 1, 0, 3)
    step = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    at = np.linalg.solve(step, (truth[:, :3] - np.array(image.GetOrigin())).T)
    found = [ndimage.map_coordinates(u[..., c], at, order=1, mode="nearest") for c in range(3)]
    return np.linalg.norm(np.stack(found, -1) - truth[:, 3:6], axis=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("cases", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--case", default="moderate")
    parser.add_argument("--out")
    parser.add_argument("--tools", default=",".join(TOOLS))
    job = parser.parse_args()
    if not job.cases:
        parser.error("give CASES or set AVENTAIL_CASES")
    folder = job.out or tempfile.mkdtemp(prefix="side-by-side-")
    job.fixed, job.bones, job.names = (f"{job.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json"))
    job.moving = f"{job.cases}/{job.case}/fraction_ct.nii.gz"
    truth = true_points(f"{job.cases}/{job.case}")
    bone = truth[:, 6]
    job.out = f"{folder}/mask"
    os.makedirs(job.out, exist_ok=True)
    aventail(job, ["--speed", "fast"])
    job.mask = f"{job.out}/body.nii.gz"
    print("| tool | time, s | soft tissue mean, mm | 95th | 99.5th | bones mean / worst, mm | time, ratio | error, ratio |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    first = None
    for tool in job.tools.split(","):
        if not installed(tool):
            print(f"| {tool} | not installed | | | | | | |", flush=True)
            continue
        job.out = f"{folder}/{tool}"
        os.makedirs(job.out, exist_ok=True)
        start = time.monotonic()
        field = {**TOOLS, **WITH_BONES}[tool](job)
        seconds = time.monotonic() - start
        error = errors(field, truth)
        soft = error[bone == 0]
        bones = [error[bone == b].mean() for b in np.unique(bone[bone > 0])]
        first = first or (seconds, soft.mean())
        print(
            f"| {tool} | {seconds:.1f} | {soft.mean():.2f} | {np.percentile(soft, 95):.2f} | {np.percentile(soft, 99.5):.1f} "
            f"| {np.mean(bones):.2f} / {max(bones):.2f} | {seconds / first[0]:.1f} | {soft.mean() / first[1]:.1f} |",
            flush=True,
        )
    if not parser.parse_args().out:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
