"""The registration tools that other scripts run side by side, with the settings of a careful user, the same for all cases.

Each tool takes a Job and returns the file of its displacement field: on planning's grid, from planning to the fraction.
"""
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass

import SimpleITK as sitk

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
AFFINE_STAGE = """[STAGE]
xform=affine
optim=rsg
impl=itk
metric=mse
max_its=100
res=4 4 2
"""
for spacing, shrink in ((60, "4 4 2"), (30, "2 2 1"), (15, "1 1 1")):
    PLASTIMATCH += "[STAGE]\n" + bspline_stage(spacing, shrink)


@dataclass
class Job:
    """One registration: planning is fixed, the fraction moving."""

    aventail: str
    fixed: str
    moving: str
    # Labels on planning's grid, and their names where the labels have none: for aventail and the tools of WITH_BONES.
    bones: str | None = None
    names: str | None = None
    # The patient in planning, as aventail finds him: for the others.
    mask: str | None = None
    out: str = "."
    # 0: all.
    threads: int = 0
    # Whether the first step of the others may scale and shear too, and begins at the images' centres.
    affine: bool = False
    # Whether the fraction is an MR.
    is_mr: bool = False


def run(command, threads=0):
    few = {"OMP_NUM_THREADS": str(threads), "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS": str(threads)} if threads else {}
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, env={**os.environ, **few})
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]}: exit {done.returncode}\n{done.stdout[-2000:]}")


def aventail(job, more=()):
    names = (["--labels", job.names] if job.names else []) + (["--modality", "mr"] if job.is_mr else [])
    run(
        [job.aventail, "register", "-q", "--planning", job.fixed, "--bones", job.bones, *names]
        + ["--fraction", job.moving, "--out", job.out, "--threads", str(job.threads), *more]
    )
    return f"{job.out}/planning_to_fraction.nii.gz"


def fast(job, more=()):
    return aventail(job, ["--speed", "fast", *more])


def plastimatch(job):
    text = PLASTIMATCH
    if job.affine:
        text = text.replace("[STAGE]", "[STAGE]\nxform=align_center\n[STAGE]", 1)
        text = text.replace("[STAGE]\nxform=bspline", AFFINE_STAGE + "[STAGE]\nxform=bspline", 1)
    with open(f"{job.out}/parameters.txt", "w", encoding="utf-8") as file:
        file.write(text.format(fixed=job.fixed, moving=job.moving, mask=job.mask, out=job.out))
    run(["plastimatch", "register", f"{job.out}/parameters.txt"], job.threads)
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
    run(["plastimatch", "register", f"{job.out}/parameters.txt"], job.threads)
    return f"{job.out}/field.mha"


def elastix_bones(job):
    rigid = f"{job.out}/rigidity.mha"
    sitk.WriteImage(sitk.Cast(near_bones(job, 0.0), sitk.sitkFloat32), rigid)
    return elastix(job, RIGIDITY.format(rigid=rigid))


def elastix(job, bspline=BSPLINE):
    first = RIGID.replace("EulerTransform", "AffineTransform") if job.affine else RIGID
    for name, text in (("rigid", first), ("bspline", bspline)):
        with open(f"{job.out}/{name}.txt", "w", encoding="utf-8") as file:
            file.write(text.replace(") (", ")\n("))
    if not shutil.which("elastix"):
        # In a process of its own, as the program.
        run([sys.executable, os.path.abspath(__file__), job.fixed, job.moving, job.mask, job.out, str(job.threads)], job.threads)
        return f"{job.out}/deformationField.mha"
    few = ["-threads", str(job.threads)] if job.threads else []
    run(
        ["elastix", "-f", job.fixed, "-m", job.moving, "-fMask", job.mask, "-out", job.out, *few]
        + ["-p", f"{job.out}/rigid.txt", "-p", f"{job.out}/bspline.txt"]
    )
    run(["transformix", "-def", "all", "-out", job.out, "-tp", f"{job.out}/TransformParameters.1.txt", *few])
    return f"{job.out}/deformationField.mha"


def itk_elastix(fixed, moving, mask, out, threads):
    """elastix by its Python package, with the parameter files that lie in the folder."""
    import itk

    parameters = itk.ParameterObject.New()
    for name in ("rigid", "bspline"):
        parameters.AddParameterFile(f"{out}/{name}.txt")
    moving = itk.imread(moving, itk.F)
    _, found = itk.elastix_registration_method(
        itk.imread(fixed, itk.F), moving, parameter_object=parameters, fixed_mask=itk.imread(mask, itk.UC),
        output_directory=out, number_of_threads=int(threads),
    )  # fmt: skip
    itk.imwrite(itk.transformix_deformation_field(moving, found), f"{out}/deformationField.mha")


def greedy(job):
    images = f"-i {job.fixed} {job.moving} -gm {job.mask}" + (f" -threads {job.threads}" if job.threads else "")
    first = "-dof 12 -m NCC 2x2x2" if job.affine else "-dof 6 -m NMI"
    metric = "NMI" if job.is_mr else "NCC 2x2x2"
    for command in (
        f"-d 3 -a {first} {images} -ia-image-centers -n 100x50x0 -o {job.out}/rigid.mat",
        f"-d 3 {images} -m {metric} -it {job.out}/rigid.mat -n 100x100x50 -s 2vox 0.5vox -o {job.out}/warp.nii.gz",
        f"-d 3 -rf {job.fixed} -r {job.out}/warp.nii.gz {job.out}/rigid.mat -rc {job.out}/field.nii.gz",
    ):
        # In a process of its own, because the library writes to the terminal.
        run([sys.executable, "-c", f"from picsl_greedy import Greedy3D; Greedy3D().execute({command!r})"], job.threads)
    return f"{job.out}/field.nii.gz"


def deeds(job, width_mm=2.0):
    """linearBCV, then deedsBCV, which know no millimetres: both images on one grid of cubes. Images of the moving coordinates, carried
    as the moving image is, are the field."""
    fixed = sitk.ReadImage(job.fixed, sitk.sitkFloat32)
    size = [int(n * s / width_mm) for n, s in zip(fixed.GetSize(), fixed.GetSpacing())]
    grid = sitk.Image(size, sitk.sitkFloat32)
    grid.SetSpacing([width_mm] * 3)
    grid.SetOrigin(fixed.GetOrigin())
    grid.SetDirection(fixed.GetDirection())
    places = sitk.PhysicalPointSource(sitk.sitkVectorFloat32, size, grid.GetOrigin(), grid.GetSpacing(), grid.GetDirection())

    def written(name, image):
        # Its readers take the voxels as they lie.
        image = sitk.Image(image)
        image.SetOrigin([0.0] * 3)
        image.SetDirection([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
        sitk.WriteImage(image, f"{job.out}/{name}.nii.gz")
        return f"{job.out}/{name}.nii.gz"

    for name, file in (("fixed", job.fixed), ("moving", job.moving)):
        image = sitk.ReadImage(file, sitk.sitkFloat32)
        outside = float(sitk.GetArrayViewFromImage(image).min())
        written(name, sitk.Resample(image, grid, sitk.Transform(), sitk.sitkLinear, outside))
    pair = ["-F", f"{job.out}/fixed.nii.gz", "-M", f"{job.out}/moving.nii.gz"]
    run(["linearBCV", *pair, "-R", "1", "-O", f"{job.out}/rigid"], job.threads)
    found = ["-O", f"{job.out}/nonlinear", "-A", f"{job.out}/rigid_matrix.txt"]
    run(["deedsBCV", *pair, *found], job.threads)
    carried = []
    for axis in range(3):
        moving = written(f"place{axis}", sitk.VectorIndexSelectionCast(places, axis))
        out = f"{job.out}/carried{axis}.nii.gz"
        run(["applyBCVfloat", "-M", moving, *found, "-D", out], job.threads)
        carried.append(sitk.GetImageFromArray(sitk.GetArrayFromImage(sitk.ReadImage(out, sitk.sitkFloat32))))
    field = sitk.Compose(carried)
    field.CopyInformation(places)
    sitk.WriteImage(field - places, f"{job.out}/field.nii.gz")
    return f"{job.out}/field.nii.gz"


TOOLS = {"aventail": aventail, "fast": fast, "plastimatch": plastimatch, "elastix": elastix, "greedy": greedy}
# By descriptors of the surroundings; built from the sources of mattiaspaul/deedsBCV.
MORE = {"deeds": deeds}
WITH_BONES = {"plastimatch-bones": plastimatch_bones, "elastix-bones": elastix_bones}


def python_runs(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def installed(tool):
    program = tool.removesuffix("-bones")
    if program in ("aventail", "fast") or shutil.which("deedsBCV" if program == "deeds" else program):
        return True
    packages = {"greedy": "import picsl_greedy", "elastix": "import itk; itk.ParameterObject"}
    return program in packages and python_runs(packages[program])


if __name__ == "__main__":
    itk_elastix(*sys.argv[1:])
