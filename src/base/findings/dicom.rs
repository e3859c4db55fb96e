//! Findings on DICOM objects.

findings! {
    DICOM:
    DICOM_COMPRESSION = refused(
        "dicom-compression",
        "The pixels' compression is not supported.",
        "Unpack: `gdcmconv --raw IN OUT`.",
    );
    DICOM_ACQUISITIONS = refused(
        "dicom-acquisitions",
        "One series mixes acquisitions or reconstructions.",
        "Export each as a series.",
    );
    DICOM_DAMAGED = refused_or_warned(
        "dicom-damaged",
        "A file is damaged; refused if possibly of the series.",
        "Export again, or move it away.",
    );
    DICOM_DUPLICATES = refused_or_warned(
        "dicom-duplicates",
        "Images share a place; refused if they differ.",
        "Export one phase or reconstruction.",
    );
    DICOM_FRAME = refused_or_warned(
        "dicom-frame",
        "Frames of reference differ, or one is missing.",
        "Give objects of one frame, or map them.",
    );
    DICOM_GAP = refused(
        "dicom-gap",
        "A slice is missing, or distances vary.",
        "Export all slices; resample uneven ones.",
    );
    DICOM_IMAGES_DIFFER = refused(
        "dicom-images-differ",
        "Images differ in orientation, size, spacing or unit.",
        "Move other images away.",
    );
    DICOM_INCOMPLETE = refused(
        "dicom-incomplete",
        "An object lacks attributes, or contradicts itself.",
        "Export or convert it again.",
    );
    DICOM_FEWER = refused_or_doubted(
        "dicom-fewer",
        "Images of a series or structure set are missing.",
        "Export the whole series, unless a part is meant.",
    );
    DICOM_LEFT_OUT = warned(
        "dicom-left-out",
        "Localizers and non-CT objects are left out.",
        "Check the slice count.",
    );
    DICOM_LOSSY = warned(
        "dicom-lossy",
        "The images were compressed with loss.",
        "Use the originals if they exist.",
    );
    DICOM_NO_CT = refused(
        "dicom-no-ct",
        "This is no CT series.",
        "Give the folder of one.",
    );
    DICOM_NO_DOSE = refused(
        "dicom-no-dose",
        "The input holds no dose.",
        "Give an RTDOSE file.",
    );
    DICOM_NO_PLAN = warned(
        "dicom-no-plan",
        "The source dose names no plan.",
        "If your system refuses the result, give a plan's dose.",
    );
    DICOM_ONE_FRAME = doubted(
        "dicom-one-frame",
        "Planning and fraction claim one frame of reference.",
        "Export each with its own; if truly one: --same-frame.",
    );
    DICOM_PADDING = warned(
        "dicom-padding",
        "Impossible values of unmeasured voxels became air.",
        "Check where they lie.",
    );
    DICOM_SEVERAL = refused(
        "dicom-several",
        "The folder holds several series.",
        "Choose FOLDER#NUMBER or FOLDER#UID.",
    );
    DICOM_TILT = refused(
        "dicom-tilt",
        "The gantry was tilted.",
        "Resample upright, for example with dcm2niix.",
    );
    DICOM_UNIT = refused_or_warned(
        "dicom-unit",
        "Rescale Type is missing or not HU.",
        "Give the series in HU.",
    );
    MR_DERIVED_MAP = refused(
        "mr-derived-map",
        "An MR series holds no magnitude images: a map, a phase, a subtraction, a projection or a mosaic by Image Type.",
        "Give the series of the magnitude images of the same scan.",
    );
}
