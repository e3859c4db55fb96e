//! Dose as its users meet it where inputs do not fit: fields the wrong way round or too small,
//! units, contours that are hard to sample. The table of balls in docs/metrics.md is made here:
//! `AVENTAIL_WRITE_DOCS=1 cargo test --test all dose`.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, files, folder};
use aventail::dose::dvh_of_contours;
use aventail::field::FieldFormat;
use aventail::geometry::Grid;
use aventail::io::{WriteOptions, direction, read_image, write_field};
use aventail::volume::contour::{Contours, Polygon, Structure};
use aventail::volume::{LabelMap, Volume};
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// A path in a folder of the running test's own: two runs at once would meet in one folder.
fn at(name: &str) -> PathBuf {
    let own = folder().join(std::thread::current().name().unwrap_or("tests"));
    fs::create_dir_all(&own).unwrap();
    own.join(name)
}

/// 11 x 11 x 11 voxels of 4 mm around the origin.
fn grid() -> Grid {
    Grid::axis_aligned([11; 3], [4.0; 3], [-20.0; 3]).unwrap()
}

/// A peak of dose in the middle of `grid`.
fn peak(name: &str, gy: f32) -> PathBuf {
    let value = |l: usize| gy * (-grid().centre(grid().voxel(l)).coords.norm_squared() / 100.0).exp() as f32;
    files::image(&at(name), &Volume::from_fn(grid(), value))
}

/// 8 mm to the left everywhere; `frames` stand in its header, or nothing does.
fn shift(name: &str, grid: &Grid, frames: Option<(&str, &str)>) -> PathBuf {
    let path = at(name);
    let description = frames.map_or(String::new(), |(from, to)| direction(from, to, FieldFormat::Nifti));
    let options = WriteOptions { description, ..WriteOptions::default() };
    write_field(&path, &Volume::filled(grid.clone(), [8.0, 0.0, 0.0]), FieldFormat::Nifti, &options).unwrap();
    path
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Runs a command line; its exit code, and what it prints on both streams.
fn run(args: &[&str]) -> (i32, String) {
    let output = aventail().args(args).output().unwrap();
    let both = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(both).unwrap())
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_field_in_the_wrong_role_is_refused_by_every_verb() {
    let dose = peak("role.nii.gz", 60.0);
    let push = shift("role_push.nii.gz", &grid(), Some(("planning", "fraction")));
    let pull = shift("role_pull.nii.gz", &grid(), Some(("fraction", "planning")));
    let (dose, push, pull) = (text(&dose), text(&push), text(&pull));
    let (out, folder) = (at("role_out.nii.gz"), at("role_out"));
    let (out, folder) = (text(&out), text(&folder));
    let map = ["dose", "map", "--dose", dose, "--to", "planning", "--grid", dose, "--out", out];
    let sum = ["dose", "accumulate", "--dose", dose, "--grid", dose, "--out", out];
    let evaluate = ["evaluate", "--quiet", "--out", folder];
    let still = ["--planning-to-fraction", push];
    for (common, wrong) in [
        (&map[..], &["--planning-to-fraction", pull][..]),
        (&map, &["--fraction-to-planning", push]),
        (&sum, &["--fields", pull]),
        (&sum, &["--fields", push, "--direction", "fraction-to-planning"]),
        (&evaluate, &["--planning-to-fraction", pull]),
        (&evaluate, &["--fraction-to-planning", push]),
        (&evaluate, &["--compare", pull, pull]),
        (&evaluate, &["--compare", push, "--direction", "fraction-to-planning"]),
        (&[&evaluate[..], &still].concat(), &["--then", push, "--direct", pull]),
    ] {
        let (code, said) = run(&[common, wrong].concat());
        assert!(
            code == 4 && said.contains("[field-direction]") && said.contains("points to"),
            "{wrong:?}: {code} {said}"
        );
    }
    // Rightly used nothing is said; a field onward from the fraction comes of a run of its own.
    for (common, right) in [
        (&map[..], &["--planning-to-fraction", push][..]),
        (&sum, &["--fields", pull, "--direction", "fraction-to-planning"]),
        (&[&evaluate[..], &still].concat(), &["--then", push, "--direct", push]),
    ] {
        let (code, said) = run(&[common, right].concat());
        assert!(code == 0 && !said.contains("field-direction"), "{right:?}: {code} {said}");
    }
}

#[test]
fn a_field_without_direction_on_the_other_images_grid_is_doubted() {
    let day = Grid::axis_aligned([9; 3], [5.0; 3], [-10.0; 3]).unwrap();
    let (plan, day_dose) =
        (peak("plan.nii.gz", 60.0), files::image(&at("day.nii.gz"), &Volume::filled(day.clone(), 2.0)));
    let (on_plan, on_day) = (shift("on_plan.mha.nii.gz", &grid(), None), shift("on_day.nii.gz", &day, None));
    let out = at("doubt.nii.gz");
    for (field, doubted) in [(&on_plan, false), (&on_day, true)] {
        let (code, said) = run(&[
            "dose",
            "map",
            "--dose",
            text(&day_dose),
            "--to",
            "planning",
            "--planning-to-fraction",
            text(field),
            "--grid",
            text(&plan),
            "--out",
            text(&out),
        ]);
        assert!(code == 0 && said.contains("field-direction") == doubted, "{said}");
        let asked = format!("planning:fraction={}", text(field));
        let (code, said) = run(&[
            "warp",
            "--field",
            &asked,
            "--from",
            "fraction",
            "--to",
            "planning",
            "--kind",
            "dose",
            "--input",
            text(&day_dose),
            "--grid",
            text(&plan),
            "--out",
            text(&out),
        ]);
        assert!(code == 0 && said.contains("field-direction") == doubted, "{said}");
    }
}

#[test]
fn dose_outside_a_field_or_another_dose_is_told() {
    let dose = peak("outside.nii.gz", 60.0);
    let small = Grid::axis_aligned([5; 3], [4.0; 3], [-8.0; 3]).unwrap();
    let small = shift("small.nii.gz", &small, None);
    let out = at("outside_out.nii.gz");
    let (d, s, o) = (text(&dose), text(&small), text(&out));
    let to_planning = ["--to", "planning", "--planning-to-fraction", s];
    let back = ["--fields", s, "--direction", "fraction-to-planning"];
    for (verb, fields) in [("map", &to_planning[..]), ("accumulate", &["--fields", s]), ("accumulate", &back)] {
        let (code, said) = run(&[&["dose", verb, "--dose", d, "--grid", d, "--out", o][..], fields].concat());
        assert!(code == 0 && said.contains("warning (outside-field): 90.6 % of the volume"), "{verb}: {said}");
        let report = read_json(&at("outside_out.json"));
        let outside = &report["parts"][0]["outside"];
        assert!((outside["volume_percent"].as_f64().unwrap() - 90.608).abs() < 0.01, "{outside}");
        assert!(outside["amount_percent"].as_f64().unwrap() > 10.0, "{outside}");
        assert_eq!(report["parts"][0]["warnings"].as_array().unwrap().last().unwrap()["code"], "outside-field");
    }
    let asked = format!("planning:fraction={s}");
    let (code, said) = run(&[
        "warp", "--field", &asked, "--from", "fraction", "--to", "planning", "--kind", "dose", "--input", d, "--grid",
        d, "--out", o,
    ]);
    assert!(code == 0 && said.contains("warning (outside-field)") && said.contains("% of the dose"), "{said}");
    let whole = read_image(&dose).unwrap().value;
    let half = Grid::axis_aligned([6, 11, 11], [4.0; 3], [-20.0; 3]).unwrap();
    let part = Volume::from_fn(half.clone(), |l| *whole.at(half.voxel(l)));
    let part = files::image(&at("part.nii.gz"), &part);
    let folder = at("outside_compare");
    let (code, said) = run(&["dose", "compare", "--dose", text(&part), "--reference", d, "--out", text(&folder)]);
    assert!(code == 0 && said.contains("warning (dose-outside)"), "{said}");
    let figures = &read_json(&folder.join("compare.json"))["difference_gy"];
    assert!(figures["magnitude"]["max"].as_f64().unwrap() < 1e-3, "what is missing is not 0 Gy: {figures}");
    let missing = figures["reference_outside"]["volume_percent"].as_f64().unwrap();
    assert!((missing - 100.0 * 5.0 / 11.0).abs() < 0.01, "{figures}");
    let (code, said) = run(&["dose", "compare", "--dose", d, "--reference", text(&part), "--out", text(&folder)]);
    assert!(code == 0 && said.contains("of the dose's volume"), "{said}");
}

/// Each dose by its own field, as often as its own weight says.
#[test]
fn accumulated_doses_have_their_own_fields_and_weights() {
    let (dose, flat) = (peak("peak.nii.gz", 2.0), at("flat.nii.gz"));
    files::image(&flat, &Volume::from_fn(grid(), |l| 1.0 + 0.1 * grid().voxel(l)[1] as f32));
    let still = at("still.nii.gz");
    let field = Volume::filled(grid(), [0.0, -4.0, 0.0]);
    write_field(&still, &field, FieldFormat::Nifti, &WriteOptions::default()).unwrap();
    let (left, out) = (shift("left.nii.gz", &grid(), None), at("sum.nii.gz"));
    let words = ["dose", "accumulate", "--dose", text(&dose), "--dose", text(&flat), "--fields", text(&left)];
    let more =
        ["--fields", text(&still), "--fractions", "2", "--fractions", "7", "--direction", "planning-to-fraction"];
    let rest = ["--grid", text(&dose), "--no-page", "--out", text(&out)];
    let (code, said) = run(&[&words[..], &more, &rest].concat());
    assert_eq!(code, 0, "{said}");
    let [sum, one, other] = [&out, &dose, &flat].map(|path| read_image(path).unwrap().value);
    // Planning point x shows what lies at x + u in the fraction: two voxels along x, one back along y.
    for voxel in [[3, 5, 5], [4, 6, 5], [5, 1, 2], [8, 10, 10]] {
        let [i, j, k] = voxel;
        let expected = 2.0 * one.at([i + 2, j, k]) + 7.0 * other.at([i, j - 1, k]);
        assert!((sum.at(voxel) - expected).abs() < 1e-4, "{voxel:?}: {} for {expected} Gy", sum.at(voxel));
    }
}

#[test]
fn units_are_judged_on_what_goes_in_and_on_what_comes_out() {
    let (day, plan) = (peak("cgy.nii.gz", 200.0), peak("gy.nii.gz", 60.0));
    let field = shift("units.nii.gz", &grid(), Some(("planning", "fraction")));
    let out = at("units_out.nii.gz");
    let sum = |dose: &Path, weight: &str| {
        run(&[
            "dose",
            "accumulate",
            "--dose",
            text(dose),
            "--fields",
            text(&field),
            "--grid",
            text(dose),
            "--fractions",
            weight,
            "--out",
            text(&out),
        ])
    };
    let (code, said) = sum(&day, "35");
    assert!(code == 4 && said.contains("[dose-units]") && said.contains("Gy"), "{said}");
    assert!(!out.exists() && !at("units_out.json").exists());
    // Twenty whole plans are a mistake, whatever their sum is.
    let more = ["--grid", text(&plan), "--weights", "20", "--out", text(&out)];
    let (code, said) =
        run(&[&["dose", "accumulate", "--dose", text(&plan), "--fields", text(&field)][..], &more].concat());
    assert!(code == 2 && said.contains("more than a whole plan") && said.contains("fractions"), "{said}");
    let (code, said) = sum(&day, "1");
    assert!(code == 0 && said.contains("warning (dose-units)") && said.contains("200.0 Gy"), "{said}");
    let (code, said) = sum(&plan, "1");
    assert!(code == 0 && !said.contains("dose-units"), "{said}");
    // A negative of rounding is counted, a larger one refused.
    let mut rounded = read_image(&plan).unwrap().value;
    rounded.data_mut()[..3].fill(-1e-6);
    let path = files::image(&at("rounded.nii.gz"), &rounded);
    let (code, said) = sum(&path, "1");
    assert!(code == 0 && said.contains("warning (dose-negative)") && said.contains("3 voxels"), "{said}");
    rounded.data_mut()[5] = -0.5;
    let (code, said) = sum(&files::image(&at("negative_dose.nii.gz"), &rounded), "1");
    assert!(code == 4 && said.contains("-0.5 Gy"), "{said}");
}

/// A structure of squares in the contour format.
fn squares(name: &str, [low, high]: [f64; 2], shift: f64, heights: &[f64], times: usize) -> Value {
    let square = |z: &f64| {
        json!([[low + shift, low, z], [high + shift, low, z], [high + shift, high, z], [low + shift, high, z]])
    };
    let all: Vec<Value> = heights.iter().flat_map(|z| (0..times).map(move |_| square(z))).collect();
    json!({"name": name, "contours": all})
}

#[test]
fn no_structure_vanishes_from_a_histogram() {
    let dose = peak("dvh_dose.nii.gz", 60.0);
    let nine: Vec<f64> = (-4..=4).map(|k| 2.0 * f64::from(k)).collect();
    let structures = [
        squares("big", [-7.0, 7.0], 0.0, &nine, 1),
        squares("cochlea", [1.0, 3.0], 0.0, &[1.0, 2.0, 3.0], 1),
        squares("twice", [-7.0, 7.0], 0.0, &nine, 2),
        squares("outside", [-7.0, 7.0], 100.0, &nine, 1),
        squares("centres", [-8.0, 8.0], 0.0, &[-12.0, -8.0, -4.0, 0.0, 4.0, 8.0], 1),
        json!({"name": "bow", "contours": [[[0, 0, 0], [9, 9, 0], [9, 0, 0], [0, 9, 0]]]}),
    ];
    let file = json!({"aventail_contours": 1, "structures": structures});
    let path = files::bytes(&at("structures.json"), file.to_string().as_bytes());
    let out = at("dvh_vanish");
    let (code, said) = run(&["dose", "dvh", "--dose", text(&dose), "--structures", text(&path), "--out", text(&out)]);
    assert_eq!(code, 0, "{said}");
    let rows = read_json(&out.join("dvh.json"))[0]["structures"].as_array().unwrap().clone();
    assert_eq!(rows.len(), 6, "{said}");
    let of = |name: &str, figure: &str| {
        let row = rows.iter().find(|r| r["name"] == name).unwrap();
        row[figure].as_f64().unwrap_or(f64::NAN)
    };
    let near = |a: f64, b: f64, tolerance: f64, what: &str| assert!((a / b - 1.0).abs() < tolerance, "{what}: {a} {b}");
    near(of("cochlea", "volume_ml"), 0.012, 0.01, "cochlea");
    // The mean of the peak itself over the cochlea, along one axis after the other.
    let along = |low: f64, high: f64| {
        let part = |n: u32| low + (high - low) * (f64::from(n) + 0.5) / 100.0;
        (0..100).map(|n| (-part(n).powi(2) / 100.0).exp()).sum::<f64>() / 100.0
    };
    near(of("cochlea", "mean"), 60.0 * along(1.0, 3.0).powi(2) * along(0.5, 3.5), 0.02, "mean of the cochlea");
    near(of("twice", "volume_ml"), of("big", "volume_ml"), 1e-9, "drawn twice");
    near(of("twice", "mean"), of("big", "mean"), 1e-9, "drawn twice");
    near(of("outside", "outside_ml"), 3.528, 0.01, "outside");
    near(of("centres", "volume_ml"), 6.144, 0.01, "sampled through centres");
    near(of("centres", "own_ml"), 6.144, 1e-6, "own volume through centres");
    for word in ["contours-repeated", "structure-outside-dose", "contours-cross", "3.5"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    let figures = fs::read_to_string(out.join("dvh_figures.csv")).unwrap();
    assert!(figures.lines().count() == 7 && figures.contains("own_ml"), "{figures}");
}

#[test]
fn one_name_with_two_numbers_is_one_structure() {
    let boxed = |name: &str, label: u16, other: u16| {
        let inside = |l: usize| grid().voxel(l).iter().all(|c| (3..8).contains(c));
        let value = |l: usize| {
            if !inside(l) {
                0
            } else if grid().voxel(l)[0] < 5 {
                other
            } else {
                label
            }
        };
        let map = LabelMap { volume: Volume::from_fn(grid(), value), names: [].into() };
        files::labels(&at(name), &map)
    };
    let (a, b, both) = (boxed("a.nii.gz", 1, 1), boxed("b.nii.gz", 7, 7), boxed("both.nii.gz", 1, 7));
    let names = files::bytes(&at("names.json"), br#"{"labels": {"1": "cord", "7": "cord"}}"#);
    let field = shift("names_field.nii.gz", &grid(), None);
    write_field(&field, &Volume::filled(grid(), [0.0; 3]), FieldFormat::Nifti, &WriteOptions::default()).unwrap();
    let out = at("names_out");
    let (code, said) = run(&[
        "evaluate",
        "--quiet",
        "--planning-to-fraction",
        text(&field),
        "--labels-planning",
        text(&a),
        "--labels-fraction",
        text(&b),
        "--labels",
        text(&names),
        "--out",
        text(&out),
    ]);
    assert_eq!(code, 0, "{said}");
    let report = read_json(&out.join("evaluation.json"));
    let contours = report["fields"][0]["assessment"]["contours"].as_array().unwrap();
    assert!(contours.len() == 1 && (contours[0]["dice"].as_f64().unwrap() - 1.0).abs() < 1e-12, "{contours:?}");
    let dose = peak("names_dose.nii.gz", 60.0);
    let (code, said) = run(&[
        "dose",
        "dvh",
        "--dose",
        text(&dose),
        "--structures",
        text(&both),
        "--labels",
        text(&names),
        "--out",
        text(&out),
    ]);
    assert!(code == 0 && said.contains("labels-joined"), "{said}");
    let rows = read_json(&out.join("dvh.json"))[0]["structures"].as_array().unwrap().clone();
    assert!(rows.len() == 1 && (rows[0]["volume_ml"].as_f64().unwrap() - 8.0).abs() < 1e-9, "{rows:?}");
}

/// A ball's circles on planes `gap` mm apart, one of them `off` mm above its middle.
fn ball(middle: Vector3<f64>, diameter: f64, gap: f64, off: f64) -> Contours {
    let reach = (diameter / gap).ceil() as i32 + 1;
    let polygons = (-reach..=reach)
        .filter_map(|k| {
            let z = off + gap * f64::from(k);
            let r = (0.25 * diameter * diameter - z * z).sqrt();
            let at = |n: u32| (TAU * f64::from(n) / 90.0).sin_cos();
            let points = (0..90).map(|n| [middle.x + r * at(n).1, middle.y + r * at(n).0]).collect();
            (r > 0.01 * diameter).then_some(Polygon { height: middle.z + z, points })
        })
        .collect();
    let structures = vec![Structure { name: "ball".into(), colour: None, polygons }];
    Contours { axes: Matrix3::identity(), structures }
}

/// Worst errors over places of a ball in the voxels: volume against the exact ball in percent, mean dose in Gy; the volume
/// that the contours enclose in percent.
fn errors(diameter: f64, spacing: f64, gap: f64) -> [f64; 3] {
    let n = (40.0 / spacing) as usize + 1;
    let grid = Grid::axis_aligned([n; 3], [spacing; 3], [-20.0; 3]).unwrap();
    // 3 Gy per mm, as steep as a dose gets: 5 % of 60 Gy.
    let dose = Volume::from_fn(grid.clone(), |l| 100.0 + 3.0 * grid.centre(grid.voxel(l)).x as f32);
    let exact = PI / 6.0 * diameter.powi(3) / 1000.0;
    let worst = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
    let places = [[0.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.31, 0.17, 0.43]];
    places.iter().fold([0.0; 3], |so_far, place| {
        let middle = Vector3::from(*place) * spacing;
        let all = ball(middle, diameter, gap, 0.25 * gap);
        let d = dvh_of_contours(&dose, &all, &[], 0.1).remove(0);
        let found =
            [100.0 * (d.volume_ml / exact - 1.0), d.mean - (100.0 + 3.0 * middle.x), 100.0 * (d.own_ml / exact - 1.0)];
        std::array::from_fn(|n| worst(so_far[n], found[n]))
    })
}

#[test]
fn the_table_of_balls_is_what_is_measured() {
    let mut table = String::from("| ball, mm | grid 1 mm | 2 mm | 3 mm | 5 mm |\n|---|---|---|---|---|\n");
    // No minus before what is rounded to nothing.
    let short = |v: f64| format!("{:+.0}", v.round() + 0.0);
    for diameter in [1.0, 2.0, 3.0, 5.0, 10.0, 20.0] {
        let mut row = format!("| {diameter} |");
        for spacing in [1.0, 2.0, 3.0, 5.0] {
            // Planes a tenth of the diameter apart: the page gives these two bounds.
            let [volume, mean, _] = errors(diameter, spacing, diameter / 10.0);
            assert!(volume.abs() < 0.75 && mean.abs() < 0.005, "{diameter} on {spacing}: {volume} %, {mean} Gy");
        }
        for spacing in [1.0, 2.0, 3.0, 5.0] {
            let [volume, mean, own] = errors(diameter, spacing, spacing);
            assert!(mean.abs() < 0.3, "{diameter} on {spacing}: {mean} Gy");
            if spacing > diameter {
                row.push_str(" |");
            } else {
                write!(row, " {} ({}) |", short(volume), short(own)).unwrap();
            }
        }
        // The page shows three of them.
        if [2.0, 5.0, 10.0].contains(&diameter) {
            table += &row;
            table.push('\n');
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md");
    let page = fs::read_to_string(&path).unwrap();
    let (head, rest) = page.split_once("<!-- balls -->\n").unwrap();
    let (written, tail) = rest.split_once("<!-- end of balls -->").unwrap();
    if std::env::var_os("AVENTAIL_WRITE_DOCS").is_some() {
        fs::write(&path, format!("{head}<!-- balls -->\n{table}<!-- end of balls -->{tail}")).unwrap();
    } else {
        assert_eq!(written, table, "docs/metrics.md is not what is measured; write it anew as this file's head tells");
    }
}
