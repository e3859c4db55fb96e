#!/usr/bin/env python3
"""Do other tools read aventail's displacement fields as aventail means them?

usage: interoperate.py AVENTAIL [CASE] [--case NAME] [--turn DEGREES] [--reuse DIR] [--formats nifti,mha,nrrd,...]

AVENTAIL  the aventail program
CASE      folder with planning_ct.nii.gz, bones.nii.gz, bones.json and NAME/fraction_ct.nii.gz;
          default: the environment variable AVENTAIL_CASES
--case    which fraction (default: moderate)
--turn    turn the fraction CT about the patient's long axis and tilt it half as much, by its header: an oblique grid
--reuse   keep results here, and take those that are here already

aventail registers the case once and exports both fields in each layout with `aventail warp --out-field`. Then SimpleITK, ANTs,
greedy, plastimatch, transformix and NiftyReg each read those layouts that they can (READERS) and warp with linear interpolation;
aventail itself warps from each layout too:
  pull  fraction_to_planning.* takes the planning CT to the fraction grid; compared with planning_on_fraction.nii.gz,
        which aventail register wrote (rounded to whole HU: 0.29 HU rms of the difference)
  push  planning_to_fraction.* takes the fraction CT to the planning grid; compared with SimpleITK's warp of the
        NIfTI field
Every tool gets the CT as float, because greedy and plastimatch compute in the type of the file and cut decimals off.
Counted are the voxels inside the body whose counterpart lies inside the other scan. Exit code 1 when any tool differs by more
than 1.5 HU rms. A tool that is not installed is skipped and named.
"""
import argparse
import os
import shutil
import subprocess
import sys
import tempfile

import numpy as np
import SimpleITK as sitk

AIR = -1000.0
LIMIT_HU = 1.5
ENDING = {
    "nifti": "nii.gz",
    "mha": "mha",
    "nrrd": "nrrd",
    "dispvect": "nii.gz",
    "niftyreg-displacement": "nii.gz",
    "niftyreg-deformation": "nii.gz",
}
ITK = {"nifti", "mha", "nrrd"}
NIFTYREG = {"niftyreg-displacement", "niftyreg-deformation"}
# Layouts that a tool reads; the others it misreads without a word (plastimatch and transformix are linked to ITK 5.2).
READERS = {
    "SimpleITK": ITK | {"dispvect"},
    "ANTs": ITK | {"dispvect"},
    "greedy": ITK | {"dispvect"},
    "plastimatch": ITK,
    "transformix": ITK,
    "NiftyReg": NIFTYREG,
    "NREG_TRANS": NIFTYREG,
    "aventail": set(ENDING),
}


def warp_simpleitk(field, moving, fixed, out):
    transform = sitk.DisplacementFieldTransform(sitk.ReadImage(field, sitk.sitkVectorFloat64))
    image = sitk.ReadImage(moving, sitk.sitkFloat32)
    sitk.WriteImage(sitk.Resample(image, sitk.ReadImage(fixed), transform, sitk.sitkLinear, AIR), out)


def warp_ants(field, moving, fixed, out):
    import ants

    image = ants.apply_transforms(
        ants.image_read(fixed), ants.image_read(moving), [field], interpolator="linear", defaultvalue=AIR
    )
    ants.image_write(image, out)


def warp_greedy(field, moving, fixed, out):
    command = f"-rf {fixed} -ri LINEAR -rb {AIR:.0f} -rm {moving} {out} -r {field}"
    # In a process of its own, because the library writes to the terminal.
    run([sys.executable, "-c", f"from picsl_greedy import Greedy3D; Greedy3D().execute({command!r})"])


def warp_plastimatch(field, moving, fixed, out):
    options = ["--default-value", f"{AIR:.0f}", "--interpolation", "linear", "--output-type", "float"]
    run(["plastimatch", "warp", "--input", moving, "--fixed", fixed, "--xf", field, "--output-img", out, *options])


def warp_transformix(field, moving, fixed, out):
    grid = sitk.ReadImage(fixed)
    # Column by column; and a B-spline of order 1 is linear interpolation (some builds lack FinalLinearInterpolator).
    direction = np.array(grid.GetDirection()).reshape(3, 3).T.ravel()
    numbers = lambda values: " ".join(repr(float(v)) for v in values)
    parameters = f"""
(Transform "DeformationFieldTransform")
(DeformationFieldFileName "{field}")
(DeformationFieldInterpolationOrder 1)
(NumberOfParameters 0)
(InitialTransformParametersFileName "NoInitialTransform")
(HowToCombineTransforms "Compose")
(FixedImageDimension 3)
(MovingImageDimension 3)
(FixedInternalImagePixelType "float")
(MovingInternalImagePixelType "float")
(Size {" ".join(str(n) for n in grid.GetSize())})
(Index 0 0 0)
(Spacing {numbers(grid.GetSpacing())})
(Origin {numbers(grid.GetOrigin())})
(Direction {numbers(direction)})
(UseDirectionCosines "true")
(ResampleInterpolator "FinalBSplineInterpolator")
(FinalBSplineInterpolationOrder 1)
(Resampler "DefaultResampler")
(DefaultPixelValue {AIR:.0f})
(ResultImageFormat "mha")
(ResultImagePixelType "float")
(CompressResultImage "false")
"""
    folder = os.path.join(os.path.dirname(out), "transformix")
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, "parameters.txt"), "w") as file:
        file.write(parameters)
    run(["transformix", "-in", moving, "-tp", file.name, "-out", folder])
    os.replace(os.path.join(folder, "result.mha"), out)


def warp_niftyreg(field, moving, fixed, out):
    image = out.replace(".mha", ".nii")
    sitk.WriteImage(sitk.ReadImage(moving), image.replace(".nii", "_moving.nii"))
    options = ["-inter", "1", "-pad", f"{AIR:.0f}"]
    run(["reg_resample", "-ref", fixed, "-flo", image.replace(".nii", "_moving.nii"), "-trans", field, "-res", image, *options])
    sitk.WriteImage(sitk.ReadImage(image, sitk.sitkFloat32), out)


def warp_by_niftyreg_rules(field, moving, fixed, out):
    """NiftyReg's reading of its own files in Python: RAS; intent_p1 0 holds positions, 1 displacements."""
    file = sitk.ReadImage(field)
    if file.GetMetaData("intent_name").strip() != "NREG_TRANS":
        raise RuntimeError(f"{field}: intent_name {file.GetMetaData('intent_name')!r}")
    u = sitk.GetArrayFromImage(file).astype(float) * [-1, -1, 1]
    if float(file.GetMetaData("intent_p1")) == 0:
        k, j, i = np.meshgrid(*(np.arange(n, dtype=float) for n in u.shape[:3]), indexing="ij")
        step = np.array(file.GetDirection()).reshape(3, 3) * np.array(file.GetSpacing())
        u -= np.stack([i, j, k], -1) @ step.T + np.array(file.GetOrigin())
    image = sitk.GetImageFromArray(u, isVector=True)
    image.CopyInformation(file)
    transform = sitk.DisplacementFieldTransform(image)
    sitk.WriteImage(sitk.Resample(sitk.ReadImage(moving, sitk.sitkFloat32), sitk.ReadImage(fixed), transform, sitk.sitkLinear, AIR), out)


def warp_aventail(field, moving, fixed, out):
    """The fixed image's frame is the one that the field points from."""
    to, source = (os.path.basename(field).split(".")[0].split("-")[0]).split("_to_")
    run([PROGRAM, "warp", "--quiet", "--field", f"{to}:{source}={field}", "--from", source, "--to", to, "--kind", "image",
         "--input", moving, "--grid", fixed, "--out", out])


def run(command):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise RuntimeError(f"{command[0]} ended with code {done.returncode}:\n{done.stdout[-2000:]}")
    return done.stdout


def version_of_package(name):
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def version_of_program(name):
    return run([name, "--version"]).split()[-1] if shutil.which(name) else None


PROGRAM = None  # aventail, as given


TOOLS = {
    "SimpleITK": (warp_simpleitk, lambda: version_of_package("SimpleITK")),
    "ANTs": (warp_ants, lambda: version_of_package("antspyx")),
    "greedy": (warp_greedy, lambda: version_of_package("picsl_greedy")),
    "plastimatch": (warp_plastimatch, lambda: version_of_program("plastimatch")),
    "transformix": (warp_transformix, lambda: version_of_program("transformix")),
    "NiftyReg": (warp_niftyreg, lambda: version_of_program("reg_resample")),
    "NREG_TRANS": (warp_by_niftyreg_rules, lambda: "in Python"),
    "aventail": (warp_aventail, lambda: version_of_program(PROGRAM)),
}


def array(path):
    return sitk.GetArrayFromImage(sitk.ReadImage(path)).astype(np.float32)


def lands_inside(field, fixed, moving):
    """Voxels of `fixed` that the field takes to a point between the voxel centres of `moving`."""
    grid, other = sitk.ReadImage(fixed), sitk.ReadImage(moving)
    u = sitk.GetArrayFromImage(sitk.ReadImage(field, sitk.sitkVectorFloat64))
    k, j, i = np.meshgrid(*(np.arange(n, dtype=float) for n in u.shape[:3]), indexing="ij")
    step = np.array(grid.GetDirection()).reshape(3, 3) * np.array(grid.GetSpacing())
    x = np.stack([i, j, k], -1) @ step.T + np.array(grid.GetOrigin()) + u
    back = np.linalg.inv(np.array(other.GetDirection()).reshape(3, 3) * np.array(other.GetSpacing()))
    index = (x - np.array(other.GetOrigin())) @ back.T
    return np.all((index >= 0) & (index <= np.array(other.GetSize()) - 1), axis=-1)


def as_float(path, out):
    sitk.WriteImage(sitk.ReadImage(path, sitk.sitkFloat32), out)
    return out


def turned(path, degrees, out):
    """The image on a grid that is turned about the image's centre."""
    image = sitk.ReadImage(path)
    turn = sitk.Euler3DTransform(image.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in image.GetSize()]))
    turn.SetRotation(np.radians(degrees / 2), 0.0, np.radians(degrees))
    image.SetOrigin(turn.TransformPoint(image.GetOrigin()))
    direction = np.array(turn.GetMatrix()).reshape(3, 3) @ np.array(image.GetDirection()).reshape(3, 3)
    image.SetDirection(direction.ravel().tolist())
    sitk.WriteImage(image, out)
    return out


def register(program, case, fraction, out):
    if not os.path.exists(os.path.join(out, "report.json")):
        planning = [("--" + role, os.path.join(case, file)) for role, file in
                    (("planning", "planning_ct.nii.gz"), ("bones", "bones.nii.gz"), ("labels", "bones.json"))]
        run([program, "register", *sum(map(list, planning), []), "--fraction", fraction, "--out", out, "--quiet"])


def exported(program, out, name, kind):
    """One of the two fields in a layout; the file's name keeps the direction."""
    ends = name.split("_to_")
    path = os.path.join(out, f"{name}-{kind}.{ENDING[kind]}")
    run([program, "warp", "--quiet", "--field", os.path.join(out, f"{name}.nii.gz"), "--from", ends[0], "--to", ends[1],
         "--out-field", path, "--dvf-format", kind])
    return path


def compare(program, case, name, degrees, kinds, work):
    """Prints one line per tool, format and direction; returns how many exceed the limit."""
    planning, fraction = os.path.join(case, "planning_ct.nii.gz"), os.path.join(case, name, "fraction_ct.nii.gz")
    if degrees:
        name = f"{name}_turned"
        fraction = turned(fraction, degrees, os.path.join(work, f"{name}.nii.gz"))
    present = {}
    for tool, (warp, version) in TOOLS.items():
        found = version()
        print(f"{tool}: {found}" if found else f"{tool}: not installed, SKIPPED")
        if found:
            present[tool] = warp
    print("\n| direction | format | tool | rms HU | 99.9th percentile HU | max HU | voxels |\n|---|---|---|---|---|---|---|")
    failed, pushed = 0, None
    moving_of = {"pull": as_float(planning, os.path.join(work, "planning.mha")), "push": as_float(fraction, os.path.join(work, "fraction.mha"))}
    out = os.path.join(work, name)
    register(program, case, fraction, out)
    own_pull, own_push = (os.path.join(out, f"{field}.nii.gz") for field in ("fraction_to_planning", "planning_to_fraction"))
    body, warped_body = os.path.join(out, "body.nii.gz"), os.path.join(out, "body_on_fraction.mha")
    transform = sitk.DisplacementFieldTransform(sitk.ReadImage(own_pull, sitk.sitkVectorFloat64))
    nearest = sitk.Resample(sitk.ReadImage(body), sitk.ReadImage(fraction), transform, sitk.sitkNearestNeighbor)
    sitk.WriteImage(nearest, warped_body)
    regions = {"pull": (array(warped_body) > 0) & lands_inside(own_pull, fraction, planning),
               "push": (array(body) > 0) & lands_inside(own_push, planning, fraction)}
    for kind in kinds:
        pull, push = (exported(program, out, field, kind) for field in ("fraction_to_planning", "planning_to_fraction"))
        for direction, field, moving, fixed in (("pull", pull, planning, fraction), ("push", push, fraction, planning)):
            region = regions[direction]
            if direction == "pull":
                reference = array(os.path.join(out, "planning_on_fraction.nii.gz"))
            elif pushed is None:
                first = os.path.join(out, "reference.mha")
                warp_simpleitk(own_push, moving, fixed, first)
                reference = pushed = array(first)
            else:
                reference = pushed
            for tool, warp in present.items():
                if kind not in READERS[tool]:
                    continue
                warped = os.path.join(out, f"{direction}_{tool}.mha")
                warp(field, moving_of[direction], fixed, warped)
                gap = np.abs(array(warped) - reference)[region].astype(float)
                rms = np.sqrt((gap**2).mean())
                bad = not rms <= LIMIT_HU
                failed += bad
                print(f"| {direction} | {kind} | {tool} | {rms:.3f}{' TOO MUCH' if bad else ''} | {np.percentile(gap, 99.9):.3f} | {gap.max():.2f} | {gap.size} |", flush=True)
                os.remove(warped)
    return failed


def main():
    parser = argparse.ArgumentParser(description="Do other tools read aventail's displacement fields as aventail means them?")
    parser.add_argument("aventail")
    parser.add_argument("folder", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--case", default="moderate")
    parser.add_argument("--turn", type=float, default=0.0)
    parser.add_argument("--reuse")
    parser.add_argument("--formats", default=",".join(ENDING))
    given = parser.parse_args()
    global PROGRAM
    PROGRAM = os.path.abspath(given.aventail)
    if not given.folder:
        parser.error("no case folder: give one, or set AVENTAIL_CASES")
    # SimpleITK warns about every NIfTI header entry that it does not carry over.
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    with tempfile.TemporaryDirectory() as scratch:
        work = os.path.abspath(given.reuse or scratch)
        os.makedirs(work, exist_ok=True)
        failed = compare(os.path.abspath(given.aventail), given.folder, given.case, given.turn, given.formats.split(","), work)
    print(f"\n{failed} above {LIMIT_HU} HU rms" if failed else f"\nall within {LIMIT_HU} HU rms")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
