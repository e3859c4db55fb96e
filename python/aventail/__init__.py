"""aventail registers a planning CT to a fraction CT for adaptive radiotherapy.

Bones move rigidly as a jointed skeleton, a chain-mail model of soft tissue carries their motion to
every voxel, and the report estimates the error of the result. Research software, not a medical
device.

Arrays are ``[z, y, x]``, components last, as SimpleITK's ``GetArrayFromImage`` gives them;
positions and vectors are x, y, z in LPS mm.
"""

from . import dose, reports
from ._aventail import __version__
from ._contours import Contours
from ._errors import (
    Error,
    InputError,
    InternalError,
    ReadError,
    RegistrationError,
    UsageError,
    WriteError,
)
from ._cohort import summary
from ._field import Field
from ._image import Image
from ._library import library, library_modes
from ._measure import evaluate, skeleton
from ._phantom import Phantom, phantom
from ._registration import Registration, RunWarning, pose, register
from .reports import Assessment, Report

__all__ = [
    "Assessment",
    "Contours",
    "Error",
    "Field",
    "Image",
    "InputError",
    "InternalError",
    "Phantom",
    "ReadError",
    "Registration",
    "RegistrationError",
    "Report",
    "RunWarning",
    "UsageError",
    "WriteError",
    "__version__",
    "dose",
    "evaluate",
    "library",
    "library_modes",
    "phantom",
    "pose",
    "register",
    "reports",
    "skeleton",
    "summary",
]
