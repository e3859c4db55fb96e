//! What a user of the viewer in the page does and sees.

use super::browser::Browser;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Waits until what was asked for is drawn.
pub fn settle(browser: &Browser) {
    browser.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))");
}

/// The pixels of a plane.
pub fn pixels(browser: &Browser, plane: &str) -> String {
    settle(browser);
    browser.text(&format!("document.querySelector('[data-plane={plane}] canvas').toDataURL()"))
}

/// What is told of the crosshair.
pub fn told(browser: &Browser, name: &str) -> String {
    settle(browser);
    browser.text(&format!("document.querySelector('[data-told={name}]').textContent")).replace('\u{2212}', "-")
}

/// Three numbers of a text as `1.0, 2.0, -3.0`.
pub fn numbers(text: &str) -> Vector3<f64> {
    let all: Vec<f64> = text.split(',').map(|t| t.trim().parse().expect("a number")).collect();
    Vector3::from_column_slice(&all)
}

/// A place on the screen: shares of the width and height of a plane's canvas.
pub fn on_canvas(browser: &Browser, plane: &str, shares: [f64; 2]) -> [f64; 2] {
    let expression = format!(
        "(() => {{ const b = document.querySelector('[data-plane={plane}] canvas').getBoundingClientRect(); \
         return [b.left + {} * b.width, b.top + {} * b.height]; }})()",
        shares[0], shares[1]
    );
    serde_json::from_value(browser.value(&expression)).expect("two numbers")
}

/// Something that the mouse does at a place of the screen.
pub fn mouse(browser: &Browser, kind: &str, [x, y]: [f64; 2], more: Value) {
    let mut parameters = json!({ "type": kind, "x": x, "y": y, "button": "none" });
    for (key, value) in more.as_object().expect("an object") {
        parameters[key] = value.clone();
    }
    browser.call("Input.dispatchMouseEvent", parameters);
}

/// A click at a place of the screen.
pub fn click(browser: &Browser, at: [f64; 2]) {
    mouse(browser, "mouseMoved", at, json!({}));
    for kind in ["mousePressed", "mouseReleased"] {
        mouse(browser, kind, at, json!({ "button": "left", "clickCount": 1 }));
    }
    settle(browser);
}
