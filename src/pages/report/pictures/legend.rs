//! Sheets of rows and the legends below them.

use super::super::canvas::{Align, Canvas, Pen, Rgb, text_width};
use super::super::colour::INK;
use super::super::plane::WIDTH;

/// Gap between planes, pixels.
const GAP: usize = 6;
/// Height of one line of legend, pixels.
const LINE: usize = 52;
const MARGIN: f64 = 12.0;
const TEXT: f64 = 26.0;

/// Rows below each other over a white strip with `lines` lines of legend that `draw` fills.
pub(in crate::report) fn sheet(rows: &[Canvas], lines: usize, draw: impl FnOnce(&mut Legend<'_>)) -> Canvas {
    let high: usize = rows.iter().map(|row| row.height() + GAP).sum();
    let mut canvas = Canvas::new(WIDTH, high + lines * LINE, [255; 3]);
    let mut y = 0;
    for row in rows {
        canvas.paste(row, 0, y);
        y += row.height() + GAP;
    }
    draw(&mut Legend { canvas: &mut canvas, x: MARGIN, y: (y + LINE / 2) as f64 });
    canvas
}

/// Writes legend entries from left to right, line by line.
pub(in crate::report) struct Legend<'a> {
    pub(in crate::report) canvas: &'a mut Canvas,
    pub(in crate::report) x: f64,
    /// Middle of the line.
    pub(in crate::report) y: f64,
}

impl Legend<'_> {
    /// Starts the next line.
    pub(in crate::report) fn next_line(&mut self) {
        self.x = MARGIN;
        self.y += LINE as f64;
    }

    /// Writes a text and moves on.
    pub(in crate::report) fn text(&mut self, text: &str) {
        self.canvas.text(text, [self.x, self.y], Pen { size: TEXT, colour: INK, halo: None, align: Align::Left });
        self.x += text_width(text, TEXT) + 30.0;
    }

    /// A filled square and its meaning.
    pub(in crate::report) fn swatch(&mut self, colour: Rgb, text: &str) {
        let (x, y) = (self.x, self.y);
        self.canvas.rectangle([x, y - 13.0], [x + 26.0, y + 13.0], [156, 163, 175]);
        self.canvas.rectangle([x + 1.0, y - 12.0], [x + 25.0, y + 12.0], colour);
        self.x += 36.0;
        self.text(text);
    }

    /// A square of stripes in two colours and its meaning.
    pub(in crate::report) fn hatched(&mut self, [ground, stripe]: [Rgb; 2], text: &str) {
        let (x, y) = (self.x, self.y);
        self.swatch(ground, text);
        for across in 0..24 {
            for down in (0..24).filter(|down| (across + down) / 6 % 2 == 1) {
                let at = [x + 1.0 + f64::from(across), y - 12.0 + f64::from(down)];
                self.canvas.rectangle(at, [at[0] + 1.0, at[1] + 1.0], stripe);
            }
        }
    }

    /// A title, a bar of `width` pixels with `colour` of shares 0 to 1, and labelled ticks at shares.
    pub(in crate::report) fn bar(
        &mut self,
        title: &str,
        width: f64,
        colour: impl Fn(f64) -> Rgb,
        ticks: &[(f64, String)],
    ) {
        self.text(title);
        let (x, y) = (self.x, self.y);
        for step in 0..width as usize {
            let at = x + step as f64;
            self.canvas.rectangle([at, y - 22.0], [at + 1.0, y - 2.0], colour(step as f64 / (width - 1.0)));
        }
        for (share, label) in ticks {
            let at = x + share * width;
            self.canvas.line([at, y - 3.0], [at, y + 3.0], 2.0, INK);
            self.canvas.text(label, [at, y + 14.0], Pen { size: 22.0, colour: INK, halo: None, align: Align::Centre });
        }
        self.x = x + width + 40.0;
    }
}
