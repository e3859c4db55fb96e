//! The page of a run in a browser: opened from disk, looked through. Where there is no
//! Chromium these tests say so and do nothing (`AVENTAIL_BROWSER` names the one to take).

use crate::support::browser::Browser;
use crate::support::viewer::{click, mouse, numbers, on_canvas, pixels, settle, told};
use crate::support::{Register, aventail, bones_alone, done, files, folder, near, phantom};
use aventail::io::{read_field, read_image, read_labels};
use aventail::volume::{LabelMap, Volume, trilinear_vector};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

/// The page of the shared run in a browser of its own, 1400 by 1000 pixels; `name` of its profile.
fn opened(name: &str) -> Option<Browser> {
    let browser = Browser::start(&folder().join(name))?;
    let screen = json!({ "width": 1400, "height": 1000, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", screen);
    browser.open(&done().out.join("report.html"));
    browser.wait("!!document.getElementById('viewer').dataset.state");
    assert_eq!(browser.text("document.getElementById('viewer').dataset.state"), "ready");
    browser.value("document.getElementById('viewer').scrollIntoView()");
    settle(&browser);
    Some(browser)
}

#[test]
fn it_opens_from_disk_without_the_network_and_is_looked_through() {
    let Some(browser) = opened("look") else { return };
    let first = pixels(&browser, "axial");
    // The wheel turns the slices of the plane that the mouse is on.
    let middle = on_canvas(&browser, "axial", [0.42, 0.45]);
    click(&browser, middle);
    let (clicked, at) = (pixels(&browser, "axial"), numbers(&told(&browser, "at")));
    mouse(&browser, "mouseWheel", middle, json!({ "deltaX": 0, "deltaY": 100 }));
    let (turned, lower) = (pixels(&browser, "axial"), numbers(&told(&browser, "at")));
    assert!(first != clicked && clicked != turned);
    assert!(lower.z < at.z && (lower - at).xy().norm() < 1e-9, "{at} {lower}");
    // So do keys, and the planes are linked.
    let (coronal, sagittal) = (pixels(&browser, "coronal"), pixels(&browser, "sagittal"));
    browser.press("PageUp");
    assert_eq!(numbers(&told(&browser, "at")), at);
    assert!(coronal != pixels(&browser, "coronal") && sagittal != pixels(&browser, "sagittal"));
    assert_eq!(pixels(&browser, "axial"), clicked);
    // Outlines off and on.
    browser.press("o");
    let bare = pixels(&browser, "axial");
    browser.press("o");
    assert!(bare != clicked && pixels(&browser, "axial") == clicked);
    // Every way to compare shows something else.
    let mut seen = vec![clicked.clone()];
    for key in ["1", "2", "3", "5", "6", "7", "4", "m", "a"] {
        browser.press(key);
        let now = pixels(&browser, "axial");
        if key == "4" {
            assert_eq!(seen.last().filter(|last| **last == now), None, "back from the difference");
            continue;
        }
        assert!(!seen.contains(&now), "key {key} shows what was there");
        seen.push(now);
    }
    // Blinking changes what is shown on its own.
    browser.press("b");
    let (one, shown) = (pixels(&browser, "sagittal"), "document.querySelector('.seen').textContent");
    let text = browser.text(shown);
    browser.wait(&format!("{shown} !== {}", json!(text)));
    assert!(pixels(&browser, "sagittal") != one);
    let (complaints, requests) = browser.complaints_and_requests();
    assert!(complaints.is_empty(), "{complaints:?}");
    let outside: Vec<_> = requests.iter().filter(|r| !r.starts_with("data:") && !r.ends_with("report.html")).collect();
    assert!(outside.is_empty() && !requests.is_empty(), "{outside:?}");
}

/// HU as told, which have steps of 4, against the voxel of an image that the crosshair lies in.
fn check_hu(told: &str, image: &Volume<f32>, at: &Point3<f64>) {
    let hu = *image.at(image.grid().voxel_at(at).expect("the crosshair lies in the image"));
    match told.strip_prefix("below ") {
        Some(least) => assert!(hu < least.parse::<f32>().expect("a number") + 2.0, "{told} {hu}"),
        None => assert!((told.parse::<f32>().expect("HU") - hu).abs() <= 2.51, "{told} {hu} at {at}"),
    }
}

#[test]
fn what_it_tells_under_the_crosshair_is_what_the_files_hold() {
    let Some(browser) = opened("tell") else { return };
    let run = &done().out;
    let report: Value = serde_json::from_slice(&std::fs::read(run.join("report.json")).unwrap()).unwrap();
    let fraction = read_image(crate::support::phantom().fraction.clone()).unwrap().value;
    let deformed = read_image(run.join("planning_on_fraction.nii.gz")).unwrap().value;
    let pull = read_field(run.join("fraction_to_planning.nii.gz")).unwrap().value;
    let half = fraction.grid().spacing().map(|s| s / 2.0);
    // A click on a landmark's line brings the crosshair there.
    let each = report["landmarks"]["each"].as_array().expect("landmarks were given");
    for (n, landmark) in each.iter().enumerate().step_by(4) {
        let name = landmark["landmark"]["name"].as_str().expect("a name");
        let line = format!(
            "[...document.querySelectorAll('[data-list=landmarks] button')].find(b => \
             b.firstChild.textContent === {}).click()",
            json!(format!("{} {name}", n + 1))
        );
        browser.value(&line);
        let at = numbers(&told(&browser, "at"));
        let meant: [f64; 3] = serde_json::from_value(landmark["landmark"]["fraction"].clone()).expect("a point");
        for a in 0..3 {
            assert!((at[a] - meant[a]).abs() <= half[a] + 0.06, "{name}: {at} {meant:?}");
        }
    }
    let mut moved = 0;
    for (plane, shares) in [
        ("coronal", [0.5, 0.3]),
        ("axial", [0.5, 0.5]),
        ("sagittal", [0.52, 0.71]),
        ("axial", [0.6, 0.4]),
        ("axial", [0.05, 0.1]),
        ("coronal", [0.55, 0.85]),
    ] {
        click(&browser, on_canvas(&browser, plane, shares));
        let at = Point3::from(numbers(&told(&browser, "at")));
        check_hu(&told(&browser, "fraction"), &fraction, &at);
        check_hu(&told(&browser, "deformed"), &deformed, &at);
        // `13.1 (1.0, 2.0, 13.0)`, planning to fraction.
        let displacement = told(&browser, "displacement");
        let Some(parts) = displacement.split(['(', ')']).nth(1) else { continue };
        let v = trilinear_vector(&pull, &pull.grid().index(&at)).expect("inside");
        assert!((numbers(parts) + v).norm() < 1.5, "{displacement} {v}");
        let from = Point3::from(numbers(&told(&browser, "from")));
        assert!((from - at - v).norm() < 1.5, "{from} {at} {v}");
        moved += usize::from(v.norm() > 3.0);
    }
    assert!(moved >= 2, "{moved} places moved");
}

#[test]
fn the_first_screen_tells_the_verdict_and_has_room_to_sign() {
    let report: Value = serde_json::from_slice(&std::fs::read(done().out.join("report.json")).unwrap()).unwrap();
    let verdict = report["verdict"].as_str().expect("a verdict");
    let all = report["verdicts"].as_array().expect("verdicts");
    let worst = ["fail", "review", "pass"].into_iter().find(|mark| all.iter().any(|v| v["verdict"] == *mark));
    assert_eq!(Some(verdict), worst);
    for v in all {
        for key in ["name", "unit", "limit", "source", "reason", "remedy"] {
            assert!(v[key].is_string(), "{key} of {v}");
        }
        assert!(v["value"].is_number() && (v["verdict"] == "pass") == (v["remedy"] == ""), "{v}");
    }
    assert!(done().stdout.contains(&format!("verdict     {}", verdict.to_uppercase())), "{}", done().stdout);
    let Some(browser) = opened("first") else { return };
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        json!({ "width": 1280, "height": 900, "deviceScaleFactor": 1, "mobile": false }),
    );
    browser.value("scrollTo(0, 0)");
    settle(&browser);
    let bottom = |selector: &str| {
        let expression = format!("document.querySelector('{selector}').getBoundingClientRect().bottom");
        browser.value(&expression).as_f64().expect("a number")
    };
    assert_eq!(browser.text("document.querySelector('.verdict .mark').textContent"), verdict);
    assert!(
        bottom(".verdict") < bottom("section.sign") && bottom("section.sign") < 900.0,
        "{}",
        bottom("section.sign")
    );
}

#[test]
fn planning_can_be_moved_by_the_couch_shift_alone() {
    let Some(browser) = opened("couch") else { return };
    let report: Value = serde_json::from_slice(&std::fs::read(done().out.join("report.json")).unwrap()).unwrap();
    let shift: Vector3<f64> = serde_json::from_value(report["couch"]["shift_mm"].clone()).expect("a shift");
    let planning = read_image(crate::support::phantom().planning.clone()).unwrap().value;
    browser.press("2");
    let press = |moved: &str| browser.value(&format!("document.querySelector('[data-moved={moved}]').click()"));
    let (deformed, _) = (pixels(&browser, "axial"), press("couch"));
    let (couch, _) = (pixels(&browser, "axial"), press("scanned"));
    assert!(deformed != couch && couch != pixels(&browser, "axial"));
    assert!(browser.text("document.querySelector('.seen').textContent").contains("as scanned"));
    press("couch");
    settle(&browser);
    assert!(browser.text("document.querySelector('.seen').textContent").contains("couch shift alone"));
    // What is bright where the couch alone has moved it to is bright in the picture.
    let bright = |at: [f64; 2]| {
        let [x, y] = at;
        let expression = format!(
            "(() => {{ const c = document.querySelector('[data-plane=axial] canvas'); \
             return c.getContext('2d').getImageData({x} * c.width, {y} * c.height, 1, 1).data[0]; }})()"
        );
        browser.value(&expression).as_f64().expect("a number")
    };
    browser.value("document.querySelectorAll('[data-flag]').forEach(box => box.checked && box.click())");
    let (mut seen, mut agree) = (0, 0);
    for n in 0..40 {
        let shares = [0.25 + 0.5 * f64::from(n % 10) / 9.0, 0.2 + 0.6 * f64::from(n / 10) / 3.0];
        click(&browser, on_canvas(&browser, "axial", shares));
        let from = Point3::from(numbers(&told(&browser, "at"))) - shift;
        let Some(hu) = aventail::volume::trilinear(&planning, &planning.grid().index(&from)) else { continue };
        // Beside the crosshair's gap, which leaves its middle free.
        let tone = bright(shares);
        if !(-700.0..=-200.0).contains(&hu) {
            seen += 1;
            agree += usize::from((hu > 0.0) == (tone > 40.0) || (-200.0..=0.0).contains(&hu));
        }
    }
    assert!(seen > 20 && agree * 10 >= seen * 9, "{agree} of {seen}");
}

#[test]
fn the_demos_page_can_be_sent_around_and_its_run_repeated_and_drawn() {
    let out = folder().join("demo");
    aventail().args(["demo", "--quiet", "--speed", "fast", "--out"]).arg(&out).assert().success();
    let bytes = std::fs::metadata(out.join("report.html")).unwrap().len();
    assert!((3_000_000..12_000_000).contains(&bytes), "{bytes} bytes");
    // It leaves what it has registered, so that other verbs find it.
    let drawn = folder().join("demo.png");
    let figure = ["--quiet", "--kind", "fusion", "--plane", "sagittal", "--out"];
    aventail().arg("figure").arg(&out).args(figure).arg(&drawn).assert().success();
    assert!(std::fs::metadata(&drawn).unwrap().len() > 20_000);
    // Its report names them, too; tests/invariance.rs repeats a run by such a report.
    let again = folder().join("demo_again");
    let config = out.join("report.json");
    let mut repeated = aventail();
    repeated.args(["register", "--estimate", "--quiet", "--config"]).arg(&config).arg("--out").arg(&again);
    repeated.assert().success();
    aventail().arg("inspect").arg(&out).assert().success();
    std::fs::write(out.join("phantom/landmarks.csv"), "other").unwrap();
    aventail().arg("inspect").arg(&out).assert().code(4);
}

#[test]
fn without_the_view_the_page_has_no_script() {
    let bare = Register::quick("bare").flag("--no-view");
    bare.command().assert().success();
    let [bare, whole] = [&bare.out, &done().out].map(|out| std::fs::read_to_string(out.join("report.html")).unwrap());
    assert!(!bare.contains("<script") && bare.contains("default-src 'none'") && !bare.contains("script-src"));
    // The pictures that need no script are in both, before, with the couch shift alone and after among them.
    for page in [&bare, &whole] {
        assert!(page.matches("data:image/png;base64,").count() >= 5 && page.contains("alt=\"Couch shift alone\""));
    }
    assert!(whole.contains("script-src 'sha256-") && whole.contains("<section class=\"viewer\" id=\"viewer\" hidden>"));
}

#[test]
fn it_fits_a_phone_and_follows_a_finger_and_the_dark() {
    let Some(browser) = opened("phone") else { return };
    let phone = json!({ "width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": true });
    browser.call("Emulation.setDeviceMetricsOverride", phone);
    browser.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": true }));
    settle(&browser);
    let wide = browser.value("document.documentElement.scrollWidth").as_f64().expect("a number");
    assert!(wide <= 390.0, "{wide}");
    let canvas = browser.value("document.querySelector('[data-plane=axial] canvas').clientWidth");
    assert!(canvas.as_f64().is_some_and(|w| w > 300.0), "{canvas}");
    browser.value("document.querySelector('[data-plane=axial]').scrollIntoView()");
    settle(&browser);
    let before = numbers(&told(&browser, "at"));
    let [x, y] = on_canvas(&browser, "axial", [0.62, 0.6]);
    browser.call("Input.dispatchTouchEvent", json!({ "type": "touchStart", "touchPoints": [{ "x": x, "y": y }] }));
    browser.call("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] }));
    let after = numbers(&told(&browser, "at"));
    assert!((after - before).xy().norm() > 5.0 && (after.z - before.z).abs() < 1e-9, "{before} {after}");
    // Ground and letters change places.
    let light = |property: &str| {
        let expression = format!("getComputedStyle(document.documentElement).{property}");
        let text = browser.text(&expression);
        text.split(|c: char| !c.is_ascii_digit()).filter_map(|t| t.parse::<f64>().ok()).sum::<f64>()
    };
    assert!(light("backgroundColor") > light("color") + 300.0);
    let dark = json!({ "features": [{ "name": "prefers-color-scheme", "value": "dark" }] });
    browser.call("Emulation.setEmulatedMedia", dark);
    assert!(light("color") > light("backgroundColor") + 300.0);
}

#[test]
fn what_must_not_be_used_says_so_on_the_first_screen() {
    // Labels 10 mm aside, let through by a setting.
    let LabelMap { volume, names } = read_labels(&phantom().bones, None).unwrap().value;
    let size = volume.grid().size();
    let aside = |l: usize| if l % size[0] >= 2 { volume.data()[l - 2] } else { 0 };
    let data: Vec<u16> = (0..volume.data().len()).map(aside).collect();
    let map = LabelMap { volume: Volume::new(volume.grid().clone(), data).unwrap(), names };
    let bones = files::labels(&folder().join("aside.nii.gz"), &map);
    let text = std::fs::read_to_string(bones_alone()).unwrap() + "[checks]\nrefuse = false\n";
    let settings = files::bytes(&folder().join("let_through.toml"), text.as_bytes());
    let run =
        Register::phantom("aside").bones(bones).with("--config", settings).with("--start", near()).flag("--quiet");
    run.command().assert().success();
    let report: Value = serde_json::from_slice(&std::fs::read(run.out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["verdict"], "fail");
    let page = std::fs::read_to_string(run.out.join("report.html")).unwrap();
    let [verdict, first] = ["class=\"verdict fail\"", "<img"].map(|what| page.find(what).expect(what));
    assert!(verdict < first && page[verdict..first].contains("labels-off-bone"));
    let Some(browser) = Browser::start(&folder().join("aside_profile")) else { return };
    let screen = json!({ "width": 1280, "height": 900, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", screen);
    browser.open(&run.out.join("report.html"));
    let seen = "(() => { const b = document.querySelector('.verdict.fail').getBoundingClientRect(); \
                return b.height > 60 && b.bottom < 880; })()";
    assert_eq!(browser.value(seen), json!(true));
}
