//! A picture of a report made small: its first plane.

use super::canvas::{Canvas, Rgb};
use std::io::Cursor;

/// Width of what is made, pixels: twice what a page shows, for screens that show more.
const WIDTH: usize = 240;

/// Samples from here on are white.
const WHITE: u8 = 240;

/// The uppermost plane of a picture of planes, small; nothing where the file is no PNG of colours.
pub(super) fn thumbnail(png: &[u8]) -> Option<Vec<u8>> {
    let (pixels, [width, height]) = decoded(png)?;
    let row = |y: usize| &pixels[y * width..(y + 1) * width];
    // Planes lie below each other, apart by white, or what few colours have made of it.
    let white = |y: &usize| row(*y).iter().flatten().all(|c| *c >= WHITE);
    let end = (1..height).find(white).unwrap_or(height);
    let by = width.div_ceil(WIDTH).max(1);
    let mean = |x: usize, y: usize| -> Rgb {
        let inside = |n: usize, most: usize| n * by..((n + 1) * by).min(most);
        let part = inside(y, end).flat_map(|y| &row(y)[inside(x, width)]);
        let (sum, n) = part.fold(([0usize; 3], 0), |(s, n), p| ([0, 1, 2].map(|c| s[c] + usize::from(p[c])), n + 1));
        sum.map(|s| u8::try_from(s / n.max(1)).unwrap_or(u8::MAX))
    };
    let canvas = Canvas::from_fn(width.div_ceil(by), end.div_ceil(by), mean);
    let mut small = Vec::new();
    canvas.write_small_png(&mut small).ok()?;
    Some(small)
}

/// Colours of the pixels of a PNG file, row by row, and its width and height.
fn decoded(file: &[u8]) -> Option<(Vec<Rgb>, [usize; 2])> {
    let mut decoder = png::Decoder::new(Cursor::new(file));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().ok()?;
    let mut bytes = vec![0; reader.output_buffer_size()?];
    let frame = reader.next_frame(&mut bytes).ok()?;
    let size = [frame.width, frame.height].map(|n| n as usize);
    let samples = frame.color_type.samples();
    let colour = |p: &[u8]| match *p {
        [r, g, b, ..] => [r, g, b],
        [grey, ..] => [grey; 3],
        [] => [0; 3],
    };
    let pixels: Vec<Rgb> = bytes.chunks_exact(samples.max(1)).take(size[0] * size[1]).map(colour).collect();
    (pixels.len() == size[0] * size[1]).then_some((pixels, size))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_plane_is_made_small() {
        // Red above, a white gap, blue below.
        let colour = |y: usize| if y < 300 { [200, 20, 20] } else { [20, 20, 200] };
        let canvas =
            Canvas::from_fn(960, 700, |_, y| if (300..306).contains(&y) { [250, 255, 247] } else { colour(y) });
        let small = thumbnail(&canvas.png_within(usize::MAX).unwrap()).unwrap();
        let (pixels, size) = decoded(&small).unwrap();
        assert_eq!(size, [240, 75]);
        assert!(pixels.iter().all(|p| *p == [200, 20, 20]), "{:?}", pixels.last());
        assert_eq!(thumbnail(b"no picture"), None);
    }
}
