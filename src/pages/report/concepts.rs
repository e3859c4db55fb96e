//! The concept figures as PNG: deformed grids, heat maps and curves side by side.

use super::canvas::{Align, Canvas, Pen, Rgb};
use super::colour::{BLUE, INK, heat};
use super::plot;
use crate::concepts::{Content, Figure, Heat, Mesh, Panel};
use crate::error::{Error, Result};
use crate::io::write_file;
use std::path::Path;

/// Longer side of a panel, pixels.
const PANEL: f64 = 420.0;
const GAP: usize = 16;
const HEAD: usize = 30;
const LINE: Rgb = [96, 112, 134];
const BONE: Rgb = [222, 205, 164];
const POINT: Rgb = [214, 40, 57];

/// Writes each figure as a PNG into `folder`, which exists; returns the file names.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write_concepts(folder: &Path, figures: &[Figure]) -> Result<Vec<String>> {
    figures
        .iter()
        .map(|figure| {
            let name = format!("{}.png", figure.name);
            let mut png = Vec::new();
            draw(figure).write_small_png(&mut png).map_err(|e| Error::Internal(format!("{name}: {e}")))?;
            write_file(folder.join(&name), |out| out.write_all(&png))?;
            Ok(name)
        })
        .collect()
}

/// All panels of a figure, at most three in a row, each under its heading.
fn draw(figure: &Figure) -> Canvas {
    let panels: Vec<(&str, Canvas)> = figure.panels.iter().map(|p| (p.title.as_str(), panel(p))).collect();
    let columns = if panels.len() == 4 { 2 } else { panels.len().min(3) };
    let wide = panels.iter().map(|p| p.1.width()).max().unwrap_or(1);
    let high = panels.iter().map(|p| p.1.height()).max().unwrap_or(1);
    let rows = panels.len().div_ceil(columns.max(1));
    let mut canvas = Canvas::new(columns * (wide + GAP) + GAP, rows * (high + HEAD) + GAP, [255; 3]);
    for (n, (title, picture)) in panels.iter().enumerate() {
        let (x, y) = (GAP + n % columns * (wide + GAP), n / columns * (high + HEAD) + HEAD);
        let pen = Pen { size: 18.0, colour: INK, halo: None, align: Align::Left };
        canvas.text(title, [x as f64, y as f64 - HEAD as f64 / 2.0], pen);
        canvas.paste(picture, x, y);
    }
    canvas
}

fn panel(panel: &Panel) -> Canvas {
    match &panel.content {
        Content::Mesh(m) => mesh(m),
        Content::Heat(h) => heat_map(h),
        Content::Curves(c) => plot::draw(c, PANEL as usize + 100, PANEL as usize - 40),
    }
}

/// Pixels per mm of a window, and its picture's size.
fn scale(window: &[[f64; 2]; 2]) -> (f64, [usize; 2]) {
    let span = [window[1][0] - window[0][0], window[1][1] - window[0][1]];
    let scale = PANEL / span[0].max(span[1]);
    (scale, span.map(|s| (s * scale).round() as usize))
}

fn mesh(m: &Mesh) -> Canvas {
    let (scale, [wide, high]) = scale(&m.window);
    let mut canvas = Canvas::new(wide, high, [255; 3]);
    let at = |p: [f64; 2]| [(p[0] - m.window[0][0]) * scale, high as f64 - (p[1] - m.window[0][1]) * scale];
    let [nx, ny] = m.size;
    for (&p, _) in m.place.iter().zip(&m.rigid).filter(|(_, rigid)| **rigid) {
        let [x, y] = at(p);
        canvas.rectangle([x - scale / 2.0, y - scale / 2.0], [x + scale / 2.0, y + scale / 2.0], BONE);
    }
    for e in 0..m.place.len() {
        let a = at(m.place[e]);
        if e % nx + 1 < nx {
            canvas.line(a, at(m.place[e + 1]), 1.0, LINE);
        }
        if e / nx + 1 < ny {
            canvas.line(a, at(m.place[e + nx]), 1.0, LINE);
        }
    }
    for s in &m.outline {
        canvas.line(at(s[0]), at(s[1]), 2.0, BLUE);
    }
    for &[from, to] in &m.points {
        canvas.arrow(at(from), at(to), 2.5, INK);
        canvas.ring(at(from), 2.0, 4.0, BLUE);
        canvas.ring(at(to), 2.0, 4.0, POINT);
    }
    canvas
}

fn heat_map(h: &Heat) -> Canvas {
    let window = [[-0.5; 2], h.size.map(|n| n as f64 - 0.5)];
    let (scale, [wide, high]) = scale(&window);
    let mut canvas = Canvas::from_fn(wide, high, |x, y| {
        let (i, j) = ((x as f64 / scale) as usize, ((high - 1 - y) as f64 / scale) as usize);
        h.value.get(i.min(h.size[0] - 1) + h.size[0] * j).copied().flatten().map_or([255; 3], heat)
    });
    let at = |p: [f64; 2]| [(p[0] + 0.5) * scale, high as f64 - (p[1] + 0.5) * scale];
    for s in &h.outline {
        canvas.line(at(s[0]), at(s[1]), 2.0, BLUE);
    }
    canvas
}
