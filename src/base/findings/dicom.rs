//! Findings on DICOM objects.

findings! {
    DICOM:
    DICOM_COMPRESSION = refused(
        "dicom-compression",
        "Pixels of a DICOM object are compressed in a way that is not read.",
        "Unpack all slices first, for example with `gdcmconv --raw IN OUT`.",
    );
    DICOM_ACQUISITIONS = refused(
        "dicom-acquisitions",
        "Slices of several acquisitions or reconstructions alternate in one series.",
        "Export each acquisition as a series of its own.",
    );
    DICOM_DAMAGED = refused_or_warned(
        "dicom-damaged",
        "A file in the same folder is damaged, empty or unreadable. Refused if it may belong to the series.",
        "Copy or export the series again; move what is no part of it elsewhere.",
    );
    DICOM_DUPLICATES = refused_or_warned(
        "dicom-duplicates",
        "Several images of a series lie at one place: refused where they differ, as phases do; one of equal ones is used.",
        "Export one phase or reconstruction as a series of its own.",
    );
    DICOM_FRAME = refused_or_warned(
        "dicom-frame",
        "Objects that are used together lie in different frames of reference; warned of where an object names none.",
        "Give objects of one frame of reference, or map one to the other first.",
    );
    DICOM_GAP = refused(
        "dicom-gap",
        "A slice of a series is missing, or distances between slices vary.",
        "Export the whole series again; resample one that was scanned with varying distances.",
    );
    DICOM_IMAGES_DIFFER = refused(
        "dicom-images-differ",
        "Images of a series differ in orientation, size, pixel spacing or unit.",
        "Move the images that are no slices of the volume elsewhere.",
    );
    DICOM_INCOMPLETE = refused(
        "dicom-incomplete",
        "A DICOM object lacks what its geometry or values need, or contradicts itself.",
        "Export it again, or convert it with a tool that knows the vendor's files.",
    );
    DICOM_FEWER = refused_or_doubted(
        "dicom-fewer",
        "A series says that it has more images than are there, or images that a structure set was drawn on are missing.",
        "Export the whole series again, unless a part of it is meant.",
    );
    DICOM_LEFT_OUT = warned(
        "dicom-left-out",
        "Localizers, or objects that are no CT images, lie in a series and are left out.",
        "Nothing, where the count is as expected.",
    );
    DICOM_LOSSY = warned(
        "dicom-lossy",
        "The images of a series were compressed with loss.",
        "Take the original images where they still exist.",
    );
    DICOM_NO_CT = refused(
        "dicom-no-ct",
        "A CT series is needed; this is MR, PET, a structure set or a plan.",
        "Give the folder of a CT series.",
    );
    DICOM_NO_DOSE = refused(
        "dicom-no-dose",
        "A dose is asked for, and what is given holds none.",
        "Give an RTDOSE file.",
    );
    DICOM_NO_PLAN = warned(
        "dicom-no-plan",
        "A dose that is written as DICOM names no plan, because its source names none.",
        "Give the dose object that belongs to a plan, where the planning system refuses the result.",
    );
    DICOM_ONE_FRAME = doubted(
        "dicom-one-frame",
        "Planning and fraction claim one frame of reference, which holds only if the patient was not set up anew.",
        "Export both with their own frames of reference; give --same-frame where one is true.",
    );
    DICOM_PADDING = warned(
        "dicom-padding",
        "Voxels that were not measured had values that no CT has; they are air now.",
        "Nothing, where they lie outside the field of view.",
    );
    DICOM_SEVERAL = refused(
        "dicom-several",
        "A folder holds several series, and it is not clear which is meant.",
        "Choose one: FOLDER#NUMBER or FOLDER#UID.",
    );
    DICOM_TILT = refused(
        "dicom-tilt",
        "The slices of a series do not follow each other along their normal: gantry tilt.",
        "Resample the series to an upright grid first, for example with dcm2niix.",
    );
    DICOM_UNIT = refused_or_warned(
        "dicom-unit",
        "The Rescale Type says that the values are not HU, or gives no unit.",
        "Give the series in HU of the same scan.",
    );
    MR_DERIVED_MAP = refused(
        "mr-derived-map",
        "An MR series holds no magnitude images: a map, a phase, a subtraction, a projection or a mosaic by Image Type.",
        "Give the series of the magnitude images of the same scan.",
    );
}
