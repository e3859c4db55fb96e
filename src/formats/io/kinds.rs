//! Files of other kinds, told by their first bytes, so that a refusal says what they are and how to convert them.

/// A kind of file that is not read.
pub(super) struct Kind {
    /// What it is, with an article.
    pub(super) what: &'static str,
    /// How to get a file that is read.
    pub(super) remedy: &'static str,
    /// Where its mark stands.
    at: usize,
    /// The mark.
    mark: &'static [u8],
}

const COMPOSITE: &str = "an HDF5 file (.h5), as ITK writes composite transforms";
const FROM_COMPOSITE: &str = "turn the transform into a displacement field: in SimpleITK \
    `TransformToDisplacementField(ReadTransform(\"t.h5\"), sitkVectorFloat64, ...grid of the fixed image...)`, in ANTs \
    `antsApplyTransforms -o [field.nii.gz,1]`; a rigid one can be written as .tfm text";
const PICTURE: &str = "convert the image with its geometry, for example from its DICOM series with dcm2niix";
const UNPACK: &str = "unpack it first";
const VTK: &str = "save the image as .mha or .nii.gz, for example in Slicer or ParaView";

const fn kind(what: &'static str, remedy: &'static str, at: usize, mark: &'static [u8]) -> Kind {
    Kind { what, remedy, at, mark }
}

const KINDS: [Kind; 20] = [
    kind(COMPOSITE, FROM_COMPOSITE, 0, b"\x89HDF\r\n\x1a\n"),
    kind("a DICOM file", "name a CT series, a dose or a structure set where one is asked for", 128, b"DICM"),
    kind("a zip archive", UNPACK, 0, b"PK\x03\x04"),
    kind("a 7z archive", UNPACK, 0, b"7z\xbc\xaf\x27\x1c"),
    kind("a bzip2 file", UNPACK, 0, b"BZh"),
    kind("an xz file", UNPACK, 0, b"\xfd7zXZ\0"),
    kind("a zstd file", UNPACK, 0, b"\x28\xb5\x2f\xfd"),
    kind("a NumPy array", "write it with its geometry, for example with SimpleITK or nibabel", 0, b"\x93NUMPY"),
    kind("a PNG picture", PICTURE, 0, b"\x89PNG"),
    kind("a JPEG picture", PICTURE, 0, b"\xff\xd8\xff"),
    kind("a TIFF picture", PICTURE, 0, b"II*\0"),
    kind("a TIFF picture", PICTURE, 0, b"MM\0*"),
    kind("a MINC file", "convert it with mnc2nii", 0, b"CDF\x01"),
    kind("a MINC file", "convert it with mnc2nii", 0, b"CDF\x02"),
    kind("a VTK XML file", VTK, 0, b"<VTKFile"),
    kind("a VTK file", VTK, 0, b"# vtk DataFile"),
    kind("a MATLAB file", "save the matrix as text, or the image as NIfTI", 0, b"MATLAB 5.0"),
    kind("a PDF document", "name another file", 0, b"%PDF"),
    kind("a gzip file", UNPACK, 0, b"\x1f\x8b"),
    kind("a web page", "open it in a browser; for a file on the web download the file itself", 0, b"<!DOCTYPE html"),
];

/// What a file with these bytes is, where it is of none of the kinds that are read.
pub(super) fn told(bytes: &[u8]) -> Option<&'static Kind> {
    KINDS.iter().find(|k| bytes.get(k.at..).is_some_and(|rest| rest.starts_with(k.mark)))
}
