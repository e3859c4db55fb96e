//! docs/guide.md: every command that it shows is run as it is typed, in an empty folder, on a coarser phantom.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, folder};
use std::fs;

/// The commands of the shell blocks, continued lines joined.
fn commands(guide: &str) -> Vec<Vec<String>> {
    let blocks = guide.split("```sh\n").skip(1).map(|b| b.split("```").next().unwrap());
    let joined: Vec<String> = blocks.map(|b| b.replace("\\\n", " ")).collect();
    let lines = joined.iter().flat_map(|b| b.lines()).filter(|l| !l.trim().is_empty());
    lines.map(|l| l.split_whitespace().map(str::to_owned).collect()).collect()
}

#[test]
fn every_command_of_the_guide_runs_as_typed() {
    let guide = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/guide.md")).unwrap();
    let place = folder().join("guide");
    fs::create_dir_all(&place).unwrap();
    let commands = commands(&guide);
    assert!(commands.len() >= 10, "{} commands", commands.len());
    for words in &commands {
        assert_eq!(words[0], "aventail", "{words:?}");
        let mut run = aventail();
        run.current_dir(&place).args(&words[1..]);
        // The phantom of the guide takes minutes without optimisation.
        if words[1] == "phantom" {
            run.args(["--spacing", "9x9x9"]);
        }
        // Fewer do here.
        if words[1] == "samples" {
            run.args(["--number", "4"]);
        }
        run.assert().success();
        for (flag, file) in words.iter().zip(&words[1..]).filter(|(f, _)| f.starts_with("--out")) {
            assert!(place.join(file).exists(), "{flag} {file} of {words:?} was not written");
        }
    }
    // There and back: the landmarks are where they were.
    let read = |file: &str, prefix: &str| -> Vec<[f64; 3]> {
        let mut table = csv::Reader::from_path(place.join(file)).unwrap();
        let header = table.headers().unwrap().clone();
        let at = ["x", "y", "z"].map(|c| header.iter().position(|h| h == format!("{prefix}{c}")).unwrap());
        table.records().map(|r| r.unwrap()).map(|r| at.map(|c| r[c].parse().unwrap())).collect()
    };
    let (before, after) = (read("data/landmarks.csv", "planning_"), read("day1/points_back.csv", ""));
    for (a, b) in before.iter().zip(&after) {
        let apart = (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
        assert!(apart < 0.01, "{a:?} came back as {b:?}");
    }
}
