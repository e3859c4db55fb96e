//! Pages on paper: few pages, whatever a run holds. Where there is no Chromium these tests say so and
//! do nothing (`AVENTAIL_BROWSER` names the one to take).

use crate::support::browser::Browser;
use crate::support::viewer::settle;
use crate::support::{aventail, done, files, folder, phantom};
use aventail::evaluate::verdict::{Mark, Verdict};
use aventail::report::dose::{DosePage, DosePicture, DoseTable};
use aventail::report::evaluation::{self, EvaluationPicture, EvaluationReport};
use aventail::report::{Picture, Report, page};
use aventail::warning::Warning;
use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::json;
use std::io::{Read, Write};
use std::path::Path;

/// Papers, in inches.
const PAPERS: [(&str, [f64; 2]); 2] = [("A4", [8.27, 11.69]), ("Letter", [8.5, 11.0])];

/// The content of each page of a PDF file: whether it shows a picture, and how many lines of text.
fn pages_of(pdf: &[u8]) -> Vec<(bool, usize)> {
    let text = String::from_utf8_lossy(pdf);
    let pages = text.split("/Type /Page\n").skip(1);
    pages
        .map(|page| {
            let page = page.split("endobj").next().expect("a page ends");
            let number = page.split("/Contents ").nth(1).and_then(|c| c.split(' ').next()).expect("it has contents");
            let head = format!("\n{number} 0 obj\n");
            let at = pdf.windows(head.len()).position(|w| w == head.as_bytes()).expect("the contents are there");
            let begin = at + pdf[at..].windows(7).position(|w| w == b"stream\n").expect("a stream") + 7;
            let mut shown = String::new();
            let read = flate2::read::ZlibDecoder::new(&pdf[begin..]).read_to_string(&mut shown);
            read.expect("the contents are deflated text");
            (page.contains("/XObject"), shown.matches("BT\n").count())
        })
        .collect()
}

/// Headings, text, pictures and tables of a printed page that lie on each other, by their rectangles, two pixels apart from rounding.
const MEETING: &str = "(() => {
    const all = [...document.querySelectorAll('h1,h2,h3,p,li,figcaption,img,table,.card,section.sign')]
        .map(e => [e, [...e.getClientRects()].filter(r => r.width > 2 && r.height > 2)]).filter(([, rects]) => rects.length);
    const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 2;
    const name = e => e.tagName + ' ' + (e.innerText || e.alt || '').slice(0, 30);
    return all.flatMap(([a, ra], n) => all.slice(n + 1)
        .filter(([b, rb]) => !a.contains(b) && !b.contains(a) && ra.some(x => rb.some(y => over(x, y))))
        .map(([b]) => name(a) + ' meets ' + name(b))).slice(0, 5).join('; ');
})()";

/// A page printed on a paper: its PDF pages. Nothing of it is cut off where it is told to be on one page, and pictures
/// are large enough to be looked at.
fn printed(browser: &Browser, (paper, [wide, high]): (&str, [f64; 2])) -> Vec<(bool, usize)> {
    // As wide as the paper between its margins of 11 mm.
    let [w, h] = [wide, high].map(|inches: f64| (inches * 96.0 - 22.0 / 25.4 * 96.0) as u32);
    browser.call("Emulation.setEmulatedMedia", json!({ "media": "print" }));
    let screen = json!({ "width": w, "height": h, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", screen);
    settle(browser);
    let cut = "[...document.querySelectorAll('.sheet')].filter(s => s.scrollHeight > s.clientHeight + 1)\
               .map(s => s.scrollHeight + ' of ' + s.clientHeight + ': ' + s.innerText.slice(0, 60)).join('; ')";
    assert_eq!(browser.text(cut), "", "{paper}");
    assert_eq!(browser.text(MEETING), "", "{paper}");
    let least =
        "Math.min(1e4, ...[...document.images].filter(i => i.getClientRects().length).map(i => i.clientHeight))";
    let least = browser.value(least).as_f64().expect("a number");
    assert!(least > 50.0, "{paper}: a picture {least} px high");
    let signed = "document.querySelector('section.sign').getBoundingClientRect().bottom + scrollY";
    assert!(browser.value(signed).as_f64().is_some_and(|y| y < f64::from(h)), "{paper}");
    browser.call("Emulation.setEmulatedMedia", json!({ "media": "" }));
    let answer = browser.call("Page.printToPDF", json!({ "paperWidth": wide, "paperHeight": high }));
    let pages = pages_of(&STANDARD.decode(answer["data"].as_str().expect("a file")).expect("base64"));
    // A heading alone is a few words.
    assert!(pages.iter().all(|(picture, words)| *picture || *words > 20), "{paper}: {pages:?}");
    pages
}

/// A paper, and whether each page printed on it shows a picture, and how many pieces of text.
type Printed = (&'static str, Vec<(bool, usize)>);

/// A page file, printed on each paper.
fn on_paper(name: &str, file: &Path) -> Option<Vec<Printed>> {
    Some(on_papers(&Browser::start(&folder().join(name))?, file))
}

fn on_papers(browser: &Browser, file: &Path) -> Vec<Printed> {
    browser.open(file);
    // What is said of the print is not said on the screen.
    let shown = "[...document.querySelectorAll('.paper')].filter(e => e.getClientRects().length).length";
    assert_eq!(browser.value(shown), 0);
    PAPERS.into_iter().map(|paper| (paper.0, printed(browser, paper))).collect()
}

/// A grey PNG file of this size.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        let all = [kind, data].concat();
        let mut sum = flate2::Crc::new();
        sum.update(&all);
        file.extend(u32::try_from(data.len()).expect("small").to_be_bytes());
        file.extend(all);
        file.extend(sum.sum().to_be_bytes());
    };
    chunk(b"IHDR", &[&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 0, 0, 0, 0]].concat());
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    let row: Vec<u8> = std::iter::once(0).chain((0..width).map(|x| (x % 251) as u8)).collect();
    (0..height).for_each(|_| packed.write_all(&row).expect("memory"));
    chunk(b"IDAT", &packed.finish().expect("memory"));
    chunk(b"IEND", &[]);
    file
}

/// A warning, a reason or a name that is longer than anyone expects.
fn long(n: usize) -> String {
    format!("finding {n} {}", "of a structure whose name and description go on for a long while, ".repeat(6))
}

/// More of everything than a run has.
fn overfull(mut report: Report) -> Report {
    let many = |n: usize| (0..n).map(|k| Warning { code: format!("kind-{}", k / 3), message: long(k) });
    report.warnings = many(45).collect();
    let verdict = |n| Verdict {
        name: format!("{} {n}", "figure of a structure with a long name".repeat(2)),
        value: 1.0,
        unit: "mm".into(),
        limit: "pass up to 2 mm, review up to 3 mm".into(),
        source: "AAPM TG-132".into(),
        verdict: Mark::Fail,
        reason: long(n),
        remedy: long(n),
    };
    report.verdicts = (0..40).map(verdict).collect();
    report.bones = (0..64).map(|n| report.bones[n % report.bones.len()].clone()).collect();
    report.bones.iter_mut().for_each(|b| b.name = format!("{}_{}", b.name, "of_a_very_long_name".repeat(3)));
    report.own_motion_mm = (0..64).map(f64::from).collect();
    let cells = report.jacobian.body;
    report.jacobian.bones = (0..40).map(|n| (long(n), cells)).collect();
    if let Some(l) = &mut report.landmarks {
        l.each = (0..200).map(|n| l.each[n % l.each.len()].clone()).collect();
        l.each.iter_mut().for_each(|r| r.landmark.name = long(1));
    }
    let [overlap, joint] = [
        json!({ "bones": [long(1), long(2)], "depth_mm": 1.0, "at": [0.0, 0.0, 0.0] }),
        json!({
            "bones": [long(1), long(2)], "planning_mm": 1.0, "fraction_mm": 9.0, "play_mm": 1.0
        }),
    ];
    let overlap = serde_json::from_value(overlap).expect("an overlap");
    report.contact.overlaps = vec![overlap; 30];
    report.contact.joints = vec![serde_json::from_value(joint).expect("a joint"); 30];
    let organ = json!({ "organ": long(3), "factor": 1.1, "reached": 1.09 });
    report.volume_changes = vec![serde_json::from_value(organ).expect("an organ"); 30];
    report.inputs = (0..40).map(|n| report.inputs[n % report.inputs.len()].clone()).collect();
    report.inputs.iter_mut().for_each(|input| input.path = format!("{}/ct.nii.gz", "a_long_folder/".repeat(24)).into());
    report
}

/// Every picture that a report can have, of this size.
fn pictures(width: u32, height: u32) -> Vec<Picture> {
    let files = ["fusion_before.png", "fusion_couch.png", "fusion_after.png", "fusion_lung.png", "displacement.png"];
    let more = ["jacobian.png", "uncertainty.png", "landmarks.png", "residuals.png", "material.png"];
    let one = |file| Picture { file, title: "Picture", caption: long(0), png: png(width, height) };
    files.into_iter().chain(more).map(one).collect()
}

#[test]
fn the_report_of_a_run_prints_on_four_pages_and_is_signed_on_the_first() {
    let Some(papers) = on_paper("run", &done().out.join("report.html")) else { return };
    for (paper, pages) in papers {
        assert!((2..=4).contains(&pages.len()) && pages[0].0 && pages[1].0, "{paper}: {pages:?}");
    }
}

#[test]
fn nothing_lies_on_anything_else_whatever_parts_a_report_has() {
    let read = || Report::read(&done().out.join("report.json"), "").expect("a report");
    let Some(browser) = Browser::start(&folder().join("parts")) else { return };
    // Half of all choices of the four, in which every choice of three of them is made.
    for parts in (0..16u32).filter(|parts| parts.count_ones() % 2 == 0) {
        let has = |bit: u32| parts >> bit & 1 == 1;
        let mut report = read();
        let mut drawn = pictures(1080, [1500, 2200][usize::from(has(3))]);
        let mut without = |files: &[&str]| drawn.retain(|p| !files.contains(&p.file));
        if !has(0) {
            report.landmarks = None;
            without(&["landmarks.png", "residuals.png"]);
        }
        if !has(1) {
            report.uncertainty = None;
            without(&["uncertainty.png"]);
        }
        if !has(2) {
            without(&["fusion_couch.png", "fusion_lung.png"]);
            report.agreement = None;
            report.warnings.clear();
        }
        let html = page(&report, &drawn, None, None);
        let name = format!("parts_{parts}");
        let file = files::bytes(&folder().join(format!("{name}.html")), html.as_bytes());
        let papers = on_papers(&browser, &file);
        assert!(papers.iter().all(|(_, pages)| (2..=4).contains(&pages.len())), "{name}: {papers:?}");
    }
}

#[test]
fn an_overfull_report_prints_on_four_pages_too() {
    let read = || Report::read(&done().out.join("report.json"), "").expect("a report");
    let full = overfull(read());
    let mut bare = read();
    bare.landmarks = None;
    let Some(browser) = Browser::start(&folder().join("overfull")) else { return };
    for (name, report, [width, height]) in
        [("tall", &full, [1080, 3600]), ("wide", &full, [1080, 380]), ("bare", &bare, [1080, 2900])]
    {
        let html = page(report, &pictures(width, height), None, None);
        let file = files::bytes(&folder().join(format!("{name}.html")), html.as_bytes());
        for (paper, pages) in on_papers(&browser, &file) {
            assert!((2..=4).contains(&pages.len()), "{name}, {paper}: {pages:?}");
        }
    }
    // What is not printed is counted; the screen has all of it.
    let html = page(&full, &[], None, None);
    for told in ["And 33 more warnings: report.json", "And 44 more bones, which move least", "And 140 more landmarks"] {
        assert!(html.contains(told), "{told}");
    }
    assert!(html.contains("finding 44 ") && html.contains("kind-14"));
}

#[test]
fn an_evaluation_prints_on_four_pages_and_a_comparison_on_six() {
    let run = &done().out;
    let fields = ["planning_to_fraction.nii.gz"].map(|name| run.join(name));
    let out = folder().join("evaluation");
    let mut command = aventail();
    command.args(["evaluate", "--out"]).arg(&out).arg("--planning-to-fraction").arg(&fields[0]);
    for (option, file) in [("--planning", &phantom().planning), ("--fraction", &phantom().fraction)] {
        command.arg(option).arg(file);
    }
    command.arg("--bones").arg(&phantom().bones).arg("--labels-planning").arg(&phantom().bones);
    command.arg("--labels-fraction").arg(run.join("bones_on_fraction.nii.gz"));
    command.arg("--landmarks").arg(&phantom().landmarks).assert().success();
    let text = std::fs::read(out.join("evaluation.json")).expect("the evaluation was written");
    let mut report: EvaluationReport = serde_json::from_slice(&text).expect("it is one");
    let Some(browser) = Browser::start(&folder().join("evaluated")) else { return };
    let papers = on_papers(&browser, &out.join("evaluation.html"));
    assert!(papers.iter().all(|(_, pages)| (2..=4).contains(&pages.len())), "{papers:?}");
    // More structures and warnings than anyone has, in one field and in five.
    report.warnings = (0..30).map(|n| Warning { code: format!("kind-{n}"), message: long(n) }).collect();
    let a = &mut report.fields[0].assessment;
    let one = a.contours[0].clone();
    a.contours =
        (0..50).map(|n| aventail::evaluate::contour::ContourMetrics { name: long(n), ..one.clone() }).collect();
    a.verdicts = (0..60).map(|n| Verdict { name: long(n), ..a.verdicts[n % a.verdicts.len()].clone() }).collect();
    let kinds =
        ["before", "shift", "after", "jacobian", "contours", "residuals", "jacobian_volume", "difference", "paired"];
    for (name, fields, most) in [("full", 1, 4), ("two", 2, 6), ("five", 5, 6)] {
        let field = report.fields[0].clone();
        report.fields =
            (1..=fields).map(|n| evaluation::Assessed { name: format!("{n}{}", long(n)), ..field.clone() }).collect();
        let of = |n: usize, kind: &str| EvaluationPicture {
            file: format!("{n}_{kind}.png"),
            title: long(n),
            caption: long(n),
            png: png(1080, 2200),
        };
        let drawn: Vec<_> = (1..=fields)
            .flat_map(|n| kinds.iter().filter(move |k| n == 1 || **k != "before").map(move |kind| of(n, kind)))
            .collect();
        let out = folder().join(name);
        std::fs::create_dir_all(&out).expect("a folder");
        evaluation::write(&out, &mut report, &drawn).expect("the page is written");
        let papers = on_papers(&browser, &out.join("evaluation.html"));
        assert!(papers.iter().all(|(_, pages)| (2..=most).contains(&pages.len())), "{name}: {papers:?}");
    }
}

#[test]
fn a_page_of_dose_prints_on_four_pages() {
    let row = |n: usize| std::iter::once(long(n)).chain((0..9).map(|k| format!("{n}.{k}"))).collect();
    let table = |n: usize| DoseTable {
        title: format!("dose {n}"),
        note: String::new(),
        head: ["structure", "ml", "mean", "D98", "D95", "D50", "D2", "D0.03cc", "greatest", "outside"]
            .map(String::from)
            .into(),
        rows: (0..70).map(row).collect(),
    };
    let report = Report::read(&done().out.join("report.json"), "").expect("a report");
    let inputs: Vec<_> = (0..30).map(|n| report.inputs[n % report.inputs.len()].clone()).collect();
    let warnings: Vec<_> = (0..30).map(|n| Warning { code: format!("kind-{n}"), message: long(n) }).collect();
    for tables in [1, 9] {
        let picture = |n| DosePicture { title: format!("picture {n}"), caption: long(n), png: png(1080, 2400) };
        let file = folder().join(format!("dose_{tables}.html"));
        let page = DosePage {
            title: long(0),
            command: long(0).repeat(9),
            inputs: &inputs,
            warnings: &warnings,
            pictures: (0..3).map(picture).collect(),
            tables: (0..tables).map(table).collect(),
        };
        page.write(&file).expect("the page is written");
        let Some(papers) = on_paper(&format!("dose_{tables}"), &file) else { return };
        assert!(papers.iter().all(|(_, pages)| (2..=4).contains(&pages.len())), "{tables}: {papers:?}");
    }
}
