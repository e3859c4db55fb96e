//! A picture in memory: pixels, smooth lines and discs, text, PNG.

use super::palette::Palette;
use super::shape::Shape;
pub(super) use super::shape::{Align, Pen, Rgb};
use embedded_graphics::Drawable;
use embedded_graphics::Pixel;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::{MonoTextStyle, iso_8859_1::FONT_10X20};
use embedded_graphics::pixelcolor::BinaryColor;
use embedded_graphics::text::{Baseline, Text, renderer::CharacterStyle};
use rayon::prelude::*;
use std::convert::Infallible;
use std::io::{self, Write};

/// Rows of pixels, top left first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
    /// What is drawn over the pixels, where it is kept apart from them.
    shapes: Option<Vec<Shape>>,
}

impl Canvas {
    pub(super) fn new(width: usize, height: usize, fill: Rgb) -> Self {
        Self { width, height, pixels: vec![fill; width * height], shapes: None }
    }

    /// A canvas with `colour(x, y)` at each pixel.
    pub(super) fn from_fn(width: usize, height: usize, colour: impl Fn(usize, usize) -> Rgb + Sync) -> Self {
        Self::by_rows(width, height, |y, row| {
            row.iter_mut().enumerate().for_each(|(x, pixel)| *pixel = colour(x, y));
        })
    }

    /// A canvas with the pixels that `paint(y, row)` sets.
    pub(super) fn by_rows(width: usize, height: usize, paint: impl Fn(usize, &mut [Rgb]) + Sync) -> Self {
        let mut canvas = Self::new(width, height, [0; 3]);
        canvas.pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| paint(y, row));
        canvas
    }

    /// Keeps what is drawn from now on apart from the pixels, and so do the pictures that this one is pasted into.
    pub(super) fn keep_shapes(&mut self) {
        self.shapes.get_or_insert_default();
    }

    /// What was kept apart.
    pub(super) fn shapes(&self) -> &[Shape] {
        self.shapes.as_deref().unwrap_or_default()
    }

    /// The picture with what was kept apart drawn into its pixels.
    pub(super) fn with_shapes_drawn(&self) -> Self {
        let mut drawn = Self { shapes: None, ..self.clone() };
        for shape in self.shapes() {
            match shape {
                Shape::Line { ends: [a, b], width, colour } => drawn.line(*a, *b, *width, *colour),
                Shape::Arrow { ends: [a, b], width, colour } => drawn.arrow(*a, *b, *width, *colour),
                Shape::Ring { centre, radius, width, colour } => drawn.ring(*centre, *radius, *width, *colour),
                Shape::Rectangle { corners: [a, b], colour } => drawn.rectangle(*a, *b, *colour),
                Shape::Text { text, at, pen } => drawn.text(text, *at, *pen),
            }
        }
        drawn
    }

    /// Whether a shape was kept.
    fn kept(&mut self, shape: impl FnOnce() -> Shape) -> bool {
        let keeps = self.shapes.as_mut().map(|shapes| shapes.push(shape()));
        keeps.is_some()
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }
    pub(super) fn height(&self) -> usize {
        self.height
    }
    /// Greatest difference of any colour from a canvas of the same size.
    #[cfg(test)]
    pub(super) fn difference(&self, other: &Self) -> u8 {
        assert_eq!((self.width, self.height), (other.width, other.height));
        self.pixels
            .as_flattened()
            .iter()
            .zip(other.pixels.as_flattened())
            .map(|(a, b)| a.abs_diff(*b))
            .max()
            .unwrap_or(0)
    }
    #[cfg(test)]
    pub(super) fn pixel(&self, x: usize, y: usize) -> Rgb {
        self.pixels[x + self.width * y]
    }

    /// Mixes `colour` into a pixel; outside the canvas nothing happens.
    pub(super) fn blend(&mut self, x: i64, y: i64, colour: Rgb, opacity: f64) {
        if opacity <= 0.0 || x < 0 || y < 0 || x >= self.width as i64 || y >= self.height as i64 {
            return;
        }
        let pixel = &mut self.pixels[x as usize + self.width * y as usize];
        *pixel = mix(*pixel, colour, opacity.min(1.0));
    }

    /// Copies `other` with its top left corner at `x`, `y`; what sticks out is cut off.
    pub(super) fn paste(&mut self, other: &Self, x: usize, y: usize) {
        if let Some(shapes) = &other.shapes {
            let by = [x as f64, y as f64];
            self.shapes.get_or_insert_default().extend(shapes.iter().map(|shape| shape.moved(by)));
        }
        let wide = other.width.min(self.width.saturating_sub(x));
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let to = x + self.width * (y + row);
            self.pixels[to..to + wide].copy_from_slice(&other.pixels[other.width * row..][..wide]);
        }
    }

    /// Fills the rectangle from `from` to `to`.
    pub(super) fn rectangle(&mut self, from: [f64; 2], to: [f64; 2], colour: Rgb) {
        if self.kept(|| Shape::Rectangle { corners: [from, to], colour }) {
            return;
        }
        let inside = |low: f64, high: f64, at: i64| (high.min(at as f64 + 1.0) - low.max(at as f64)).clamp(0.0, 1.0);
        for y in from[1].floor() as i64..to[1].ceil() as i64 {
            for x in from[0].floor() as i64..to[0].ceil() as i64 {
                self.blend(x, y, colour, inside(from[0], to[0], x) * inside(from[1], to[1], y));
            }
        }
    }

    /// A line with round ends.
    pub(super) fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64, colour: Rgb) {
        if self.kept(|| Shape::Line { ends: [a, b], width, colour }) {
            return;
        }
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let long = (dx * dx + dy * dy).max(1e-12);
        self.shape([a, b], width / 2.0, colour, |x, y| {
            let t = (((x - a[0]) * dx + (y - a[1]) * dy) / long).clamp(0.0, 1.0);
            width / 2.0 - (x - a[0] - t * dx).hypot(y - a[1] - t * dy)
        });
    }

    /// A circle line around `centre`.
    pub(super) fn ring(&mut self, centre: [f64; 2], radius: f64, width: f64, colour: Rgb) {
        if self.kept(|| Shape::Ring { centre, radius, width, colour }) {
            return;
        }
        self.shape([centre, centre], radius + width, colour, |x, y| {
            width / 2.0 - ((x - centre[0]).hypot(y - centre[1]) - radius).abs()
        });
    }

    /// An arrow from `a` to `b` with a filled head.
    pub(super) fn arrow(&mut self, a: [f64; 2], b: [f64; 2], width: f64, colour: Rgb) {
        if self.kept(|| Shape::Arrow { ends: [a, b], width, colour }) {
            return;
        }
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let long = dx.hypot(dy);
        if long < 1e-6 {
            return self.line(a, a, width, colour);
        }
        let head = (4.0 * width).min(0.6 * long);
        let (ex, ey) = (dx / long, dy / long);
        let neck = [b[0] - head * ex, b[1] - head * ey];
        self.line(a, neck, width, colour);
        // Inside the head: within a wedge of half-width 0.42 of the distance to the tip.
        self.shape([neck, b], head, colour, |x, y| {
            let along = (b[0] - x) * ex + (b[1] - y) * ey;
            let across = ((b[0] - x) * ey - (b[1] - y) * ex).abs();
            (0.42 * along - across).min(head - along)
        });
    }

    /// Fills where `depth(x, y)`, the distance inside the shape in pixels, is positive, with smooth edges.
    fn shape(&mut self, ends: [[f64; 2]; 2], reach: f64, colour: Rgb, depth: impl Fn(f64, f64) -> f64) {
        let low = |a: usize| (ends[0][a].min(ends[1][a]) - reach - 1.0).floor().max(0.0) as i64;
        let high = |a: usize, size: usize| (ends[0][a].max(ends[1][a]) + reach + 1.0).ceil().min(size as f64) as i64;
        for y in low(1)..high(1, self.height) {
            for x in low(0)..high(0, self.width) {
                self.blend(x, y, colour, depth(x as f64 + 0.5, y as f64 + 0.5) + 0.5);
            }
        }
    }

    /// Writes `text` at `at`. Characters beyond Latin-1 show as question marks.
    pub(super) fn text(&mut self, text: &str, at: [f64; 2], pen: Pen) {
        if self.kept(|| Shape::Text { text: text.to_owned(), at, pen }) {
            return;
        }
        let glyphs = Glyphs::of(text);
        let scale = pen.size / GLYPH_HEIGHT as f64;
        let (wide, high) = (glyphs.width as f64 * scale, pen.size);
        let left = match pen.align {
            Align::Left => at[0],
            Align::Centre => at[0] - wide / 2.0,
            Align::Right => at[0] - wide,
        };
        let top = at[1] - high / 2.0;
        let mut layer = |colour: Rgb, threshold: f64, softness: f64| {
            for y in (top - 3.0).floor() as i64..(top + high + 3.0).ceil() as i64 {
                for x in (left - 3.0).floor() as i64..(left + wide + 3.0).ceil() as i64 {
                    let ink = glyphs.ink((x as f64 + 0.5 - left) / scale, (y as f64 + 0.5 - top) / scale);
                    self.blend(x, y, colour, (ink - threshold) / softness);
                }
            }
        };
        if let Some(halo) = pen.halo {
            layer(halo, 0.0, 0.25);
        }
        layer(pen.colour, 0.32, 0.3);
    }

    /// Writes the picture as PNG with at most 256 colours, packed as small as can be: for line art, which lasts.
    pub(super) fn write_small_png(&self, out: &mut dyn Write) -> io::Result<()> {
        self.write(out, 256, png::DeflateCompression::Level(9))
    }

    /// Writes the picture as PNG with at most 256 colours, in little time.
    pub(super) fn write_png(&self, out: &mut dyn Write) -> io::Result<()> {
        self.write(out, 256, QUICK)
    }

    /// The picture as a PNG file of at most `most` bytes: with fewer colours where 256 take more, as noise does.
    pub(super) fn png_within(&self, most: usize) -> io::Result<Vec<u8>> {
        let mut png = Vec::new();
        for colours in [256, 64, 20, 8] {
            png.clear();
            self.write(&mut png, colours, QUICK)?;
            if png.len() <= most {
                break;
            }
        }
        Ok(png)
    }

    /// Writes the pixels as 8-bit RGB PNG, none changed.
    pub(super) fn write_whole_png(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(())
    }

    fn write(&self, out: &mut dyn Write, colours: usize, packed: png::DeflateCompression) -> io::Result<()> {
        let palette = Palette::of(&self.pixels, colours);
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(palette.bytes());
        encoder.set_deflate_compression(packed);
        encoder.set_filter(png::Filter::NoFilter);
        let mut writer = encoder.write_header()?;
        let places: Vec<u8> = self.pixels.iter().map(|p| palette.place(p)).collect();
        writer.write_image_data(&places)?;
        writer.finish()?;
        Ok(())
    }
}

/// Packs to half of what the fastest way does, in as much time.
const QUICK: png::DeflateCompression = png::DeflateCompression::Level(4);

/// The nearest of 256 levels.
pub(super) fn level(value: f64) -> u8 {
    // The cast holds what is beyond the ends, and is cheaper than rounding.
    (value + 0.5) as u8
}

/// `a` with `share` (0 to 1) of `b`.
pub(super) fn mix(a: Rgb, b: Rgb, share: f64) -> Rgb {
    std::array::from_fn(|c| level(f64::from(a[c]) * (1.0 - share) + f64::from(b[c]) * share))
}

/// Size of a character of the font, pixels.
const GLYPH_WIDTH: usize = 10;
const GLYPH_HEIGHT: usize = 20;

/// Width of a text of `size` height, pixels.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    (text.chars().count() * GLYPH_WIDTH) as f64 * size / GLYPH_HEIGHT as f64
}

/// A text as black-and-white dots, from which smooth letters of any size are made.
struct Glyphs {
    width: usize,
    dots: Vec<bool>,
}

impl Glyphs {
    fn of(text: &str) -> Self {
        let width = text.chars().count() * GLYPH_WIDTH;
        let mut glyphs = Self { width, dots: vec![false; width * GLYPH_HEIGHT] };
        let mut style = MonoTextStyle::new(&FONT_10X20, BinaryColor::On);
        style.set_background_color(None);
        let drawn = Text::with_baseline(text, Point::zero(), style, Baseline::Top).draw(&mut glyphs);
        match drawn {
            Ok(_) => glyphs,
            Err(never) => match never {},
        }
    }

    /// Amount of ink (0 to 1) around a place: the dots blurred with a tent of 1.2 dots.
    fn ink(&self, x: f64, y: f64) -> f64 {
        const REACH: f64 = 1.2;
        let (mut sum, mut weight) = (0.0, 0.0);
        for j in (y - 0.5 - REACH).ceil() as i64..=(y - 0.5 + REACH).floor() as i64 {
            for i in (x - 0.5 - REACH).ceil() as i64..=(x - 0.5 + REACH).floor() as i64 {
                let w = (REACH - (i as f64 + 0.5 - x).abs()) * (REACH - (j as f64 + 0.5 - y).abs());
                weight += w;
                let inside = i >= 0 && j >= 0 && i < self.width as i64 && j < GLYPH_HEIGHT as i64;
                if inside && self.dots[i as usize + self.width * j as usize] {
                    sum += w;
                }
            }
        }
        if weight > 0.0 { sum / weight } else { 0.0 }
    }
}

impl OriginDimensions for Glyphs {
    fn size(&self) -> Size {
        Size::new(self.width as u32, GLYPH_HEIGHT as u32)
    }
}

impl DrawTarget for Glyphs {
    type Color = BinaryColor;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<BinaryColor>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            if at.x >= 0 && at.y >= 0 && (at.x as usize) < self.width && (at.y as usize) < GLYPH_HEIGHT {
                self.dots[at.x as usize + self.width * at.y as usize] = colour.is_on();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pixels of a PNG file.
    fn read(bytes: &[u8]) -> Vec<u8> {
        let mut decoder = png::Decoder::new(io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        back
    }

    #[test]
    fn png_gives_the_pixels_back() {
        let canvas = Canvas::from_fn(7, 5, |x, y| [x as u8 * 30, y as u8 * 50, 9]);
        let (mut quick, mut small) = (Vec::new(), Vec::new());
        canvas.write_png(&mut quick).unwrap();
        canvas.write_small_png(&mut small).unwrap();
        assert_eq!((read(&quick), read(&small)), (canvas.pixels.as_flattened().to_vec(), read(&quick)));
    }

    #[test]
    fn noise_loses_colours_until_it_fits() {
        let noise = |x: usize, y: usize| {
            let n = (x as u32).wrapping_mul(2_654_435_761) ^ (y as u32).wrapping_mul(40_503).wrapping_mul(97_861);
            let n = (n ^ n >> 15).wrapping_mul(2_246_822_519);
            [(n >> 8) as u8, (n >> 16) as u8, (n >> 24) as u8]
        };
        let canvas = Canvas::from_fn(300, 200, noise);
        let whole = canvas.png_within(usize::MAX).unwrap();
        let less = canvas.png_within(40_000).unwrap();
        assert!(whole.len() > 50_000 && less.len() <= 40_000, "{} {}", whole.len(), less.len());
        assert_eq!(read(&less).len(), 3 * 300 * 200);
    }

    #[test]
    fn shapes_cover_what_they_should() {
        let mut c = Canvas::new(60, 40, [255; 3]);
        c.line([10.0, 10.0], [40.0, 10.0], 4.0, [0; 3]);
        assert_eq!((c.pixel(25, 10), c.pixel(25, 14), c.pixel(45, 10)), ([0; 3], [255; 3], [255; 3]));
        c.ring([30.0, 28.0], 8.0, 2.0, [255, 0, 0]);
        assert_eq!((c.pixel(30, 28), c.pixel(37, 28)), ([255; 3], [255, 0, 0]));
        c.arrow([5.0, 20.0], [55.0, 20.0], 3.0, [0, 0, 255]);
        assert_eq!((c.pixel(48, 20), c.pixel(57, 20)), ([0, 0, 255], [255; 3]));
        assert!(c.pixel(44, 23)[0] < 60 && c.pixel(38, 23)[0] == 255, "the head is wider than the shaft");
        c.rectangle([-5.0, 35.0], [100.0, 38.5], [0; 3]); // beyond the canvas: cut off
        assert_eq!((c.pixel(0, 36), c.pixel(59, 38)), ([0; 3], [128; 3]));
    }

    #[test]
    fn text_is_drawn_where_it_is_put() {
        let ink = |align| {
            let mut c = Canvas::new(100, 30, [255; 3]);
            c.text("HI \u{b0}", [50.0, 15.0], Pen { size: 20.0, colour: [0; 3], halo: None, align });
            let dark = |range: std::ops::Range<usize>| {
                range.flat_map(|x| (0..30).map(move |y| (x, y))).filter(|&(x, y)| c.pixel(x, y)[0] < 100).count()
            };
            [dark(0..50), dark(50..100)]
        };
        let (left, right) = (ink(Align::Left), ink(Align::Right));
        assert!(left[0] == 0 && left[1] > 40 && right[1] == 0 && right[0] > 40, "{left:?} {right:?}");
        assert!((text_width("abc", 20.0) - 30.0).abs() < 1e-12);
    }
}
