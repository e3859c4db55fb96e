//! Shapes of a picture that stay lines and letters, and their file.

use super::canvas::Canvas;
use super::shape::{Align, Rgb, Shape};
use base64::{Engine, engine::general_purpose::STANDARD};
use std::fmt::Write as _;
use std::io;

fn css([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// A picture as SVG: its pixels as they are, what is drawn over them as shapes. `width_mm` on paper.
///
/// # Errors
/// When the pixels cannot be encoded.
pub(super) fn svg(canvas: &Canvas, title: &str, width_mm: f64) -> io::Result<String> {
    let (wide, high) = (canvas.width(), canvas.height());
    let mut png = Vec::new();
    canvas.write_whole_png(&mut png)?;
    let mut out = String::new();
    let mut add = |text: std::fmt::Arguments<'_>| out.write_fmt(text).expect("writing to a string does not fail");
    add(format_args!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width_mm}mm\" height=\"{:.2}mm\" viewBox=\"0 0 {wide} {high}\" \
         font-family=\"Helvetica, Arial, sans-serif\">\n<title>{}</title>\n\
         <image width=\"{wide}\" height=\"{high}\" href=\"data:image/png;base64,{}\"/>\n",
        width_mm * high as f64 / wide as f64,
        escaped(title),
        STANDARD.encode(png)
    ));
    let shapes = canvas.shapes();
    let mut n = 0;
    while n < shapes.len() {
        if let Shape::Line { width, colour, .. } = &shapes[n] {
            // Lines of one look that follow each other are one path.
            let alike = |s: &&Shape| matches!(s, Shape::Line { width: w, colour: c, .. } if w.to_bits() == width.to_bits() && c == colour);
            let run = shapes[n..].iter().take_while(alike).count();
            let path: String = shapes[n..n + run].iter().map(line_of).collect();
            add(format_args!(
                "<path d=\"{path}\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linecap=\"round\" fill=\"none\"/>\n",
                css(*colour)
            ));
            n += run;
        } else {
            add(format_args!("{}\n", element(&shapes[n])));
            n += 1;
        }
    }
    add(format_args!("</svg>\n"));
    Ok(out)
}

/// A line as a part of a path.
fn line_of(shape: &Shape) -> String {
    match shape {
        Shape::Line { ends: [[a, b], [c, d]], .. } => format!("M{a:.1} {b:.1}L{c:.1} {d:.1}"),
        _ => String::new(),
    }
}

fn element(shape: &Shape) -> String {
    match shape {
        Shape::Line { .. } => String::new(),
        Shape::Arrow { ends: [[ax, ay], [bx, by]], width, colour } => {
            let (dx, dy) = (bx - ax, by - ay);
            let long = dx.hypot(dy).max(1e-6);
            let head = (4.0 * width).min(0.6 * long);
            let (ex, ey) = (dx / long, dy / long);
            let (nx, ny) = (bx - head * ex, by - head * ey);
            let (wx, wy) = (0.42 * head * ey, -0.42 * head * ex);
            let colour = css(*colour);
            format!(
                "<path d=\"M{ax:.1} {ay:.1}L{nx:.1} {ny:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\" fill=\"none\"/>\
                 <path d=\"M{bx:.1} {by:.1}L{:.1} {:.1}L{:.1} {:.1}Z\" fill=\"{colour}\"/>",
                nx + wx,
                ny + wy,
                nx - wx,
                ny - wy
            )
        }
        Shape::Ring { centre: [x, y], radius, width, colour } => format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" stroke=\"{}\" stroke-width=\"{width}\" fill=\"none\"/>",
            css(*colour)
        ),
        Shape::Rectangle { corners: [[a, b], [c, d]], colour } => format!(
            "<rect x=\"{a:.1}\" y=\"{b:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\"/>",
            c - a,
            d - b,
            css(*colour)
        ),
        Shape::Text { text, at: [x, y], pen } => {
            let anchor = match pen.align {
                Align::Left => "start",
                Align::Centre => "middle",
                Align::Right => "end",
            };
            let halo = pen.halo.map_or(String::new(), |c| {
                format!(" stroke=\"{}\" stroke-width=\"5\" stroke-linejoin=\"round\" paint-order=\"stroke\"", css(c))
            });
            // The anchor is at half the height of a letter.
            let size = 0.85 * pen.size;
            format!(
                "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{size:.1}\" text-anchor=\"{anchor}\" fill=\"{}\"{halo}>{}</text>",
                y + 0.35 * size,
                css(pen.colour),
                escaped(text)
            )
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::super::shape::Pen;
    use super::*;

    #[test]
    fn shapes_stay_shapes_and_follow_their_picture() {
        let mut part = Canvas::new(40, 20, [10; 3]);
        part.keep_shapes();
        part.line([0.0, 0.0], [10.0, 5.0], 2.0, [255, 0, 0]);
        part.line([10.0, 5.0], [20.0, 5.0], 2.0, [255, 0, 0]);
        part.text("<R>", [5.0, 5.0], Pen { size: 10.0, colour: [0; 3], halo: None, align: Align::Left });
        assert_eq!(part.pixel(5, 2), [10; 3], "the pixels below stay as they are");
        let mut whole = Canvas::new(100, 50, [255; 3]);
        whole.paste(&part, 30, 10);
        let text = svg(&whole, "a & b", 85.0).unwrap();
        assert!(text.contains("d=\"M30.0 10.0L40.0 15.0M40.0 15.0L50.0 15.0\" stroke=\"#ff0000\""), "{text}");
        assert!(
            text.contains("&lt;R&gt;")
                && text.contains("a &amp; b")
                && text.contains("width=\"85mm\" height=\"42.50mm\"")
        );
        assert_eq!(text.matches("<image").count(), 1);
    }
}
