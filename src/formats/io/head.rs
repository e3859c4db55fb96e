//! The headers of image files, for what must be known before values are read.

use super::dicom;
use super::gzip::GzipContent;
use super::load::{load, parse};
use crate::error::Result;
use crate::findings;
use crate::geometry::Grid;
use crate::warning::Warning;
use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes of a file within which its header ends, by far.
const FIRST: u64 = 1 << 18;
/// Header lines of values that are compressed, and what they say of plain values.
const PACKED: [(&[u8], &[u8]); 4] = [
    (b"encoding: gzip", b"encoding: raw"),
    (b"encoding: gz", b"encoding: raw"),
    (b"CompressedData = True", b"CompressedData = False"),
    (b"CompressedData = 1", b"CompressedData = False"),
];

/// Reads the grid of any image, label map or field, without its values, and what is odd about it.
///
/// # Errors
/// As [`super::read_image`], but for the values.
pub fn read_grid(path: impl AsRef<Path>) -> Result<(Grid, Vec<Warning>)> {
    let path = path.as_ref();
    if dicom::is_place(path) {
        return dicom::read_grid(path);
    }
    if let Some((grid, warnings)) = head(path) {
        return Ok((grid, warnings));
    }
    // What the first bytes do not tell the whole file does, or its refusal.
    let loaded = load(path, |raster| Ok(raster.grid.clone()))?;
    Ok((loaded.value, loaded.warnings))
}

/// The grid by the first bytes of a file, where they tell.
fn head(path: &Path) -> Option<(Grid, Vec<Warning>)> {
    let mut file = File::open(path).ok().filter(|f| f.metadata().is_ok_and(|m| m.is_file()))?;
    let mut raw = Vec::new();
    file.by_ref().take(FIRST).read_to_end(&mut raw).ok()?;
    let bytes = plain(&raw)?;
    let raster = parse(path, &bytes).ok()?;
    // Extensions are cut off here, not in the file.
    let real = |w: &Warning| !w.is(findings::EXTENSION_DAMAGED);
    Some((raster.grid, raster.warnings.into_iter().filter(real).collect()))
}

/// The same header before values that are not compressed, so that it is parsed without them.
fn plain(raw: &[u8]) -> Option<Cow<'_, [u8]>> {
    let mut content = GzipContent::new(raw);
    if let GzipContent::Packed(..) = content {
        return content.first(1 << 12).ok().map(|bytes| Cow::Owned(bytes.to_vec()));
    }
    for (packed, plain) in PACKED {
        if let Some(at) = raw.windows(packed.len()).position(|w| w == packed) {
            return Some(Cow::Owned([&raw[..at], plain, &raw[at + packed.len()..]].concat()));
        }
    }
    Some(Cow::Borrowed(raw))
}

#[cfg(test)]
mod tests {
    use super::super::{Stored, WriteOptions, read_image, write_image};
    use super::*;
    use crate::volume::Volume;

    #[test]
    fn headers_alone_give_the_same_grid_whatever_follows() {
        let dir = tempfile::tempdir().unwrap();
        let grid = Grid::axis_aligned([60, 50, 40], [0.5, 1.5, 3.0], [10.0, -20.0, 30.0]).unwrap();
        // Noise, which does not compress.
        let noise = |l: usize| (l.wrapping_mul(2_654_435_761) % 4001) as f32;
        let image = Volume::from_fn(grid, noise);
        for name in ["a.nii", "a.nii.gz", "a.mha", "a.nrrd"] {
            let path = dir.path().join(name);
            write_image(&path, &image, Stored::Float32, &WriteOptions::default()).unwrap();
            let whole = read_image(&path).unwrap().value.grid().clone();
            let bytes = std::fs::read(&path).unwrap();
            std::fs::write(&path, &bytes[..6000]).unwrap();
            assert!(read_image(&path).is_err());
            assert!(read_grid(&path).unwrap().0.matches(&whole, 1e-9), "{name}");
        }
        let path = dir.path().join("b.nii");
        std::fs::write(&path, b"no image at all").unwrap();
        assert_eq!(read_grid(&path).unwrap_err().to_string(), read_image(&path).unwrap_err().to_string());
    }
}
