//! `aventail slicer`: the description, the installed module, and a run as Slicer does it.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, folder, quick_settings, small_phantom};
use aventail::io::{read_field, read_image, read_label_map};
use quick_xml::Reader;
use quick_xml::events::Event;
use std::fs;
use std::path::Path;
use std::process::Command;

/// A parameter of the description: its element, attributes and inner elements.
#[derive(Default, Debug)]
struct Parameter {
    tag: String,
    attributes: String,
    inner: Vec<(String, String)>,
}

impl Parameter {
    fn get(&self, name: &str) -> &str {
        self.inner.iter().find(|(n, _)| n == name).map_or("", |(_, text)| text)
    }
}

/// Elements of the head, and parameters.
fn description(xml: &str) -> (Vec<String>, Vec<Parameter>) {
    let mut reader = Reader::from_str(xml);
    reader.config_mut().trim_text(true);
    let (mut path, mut head, mut parameters) = (Vec::<String>::new(), Vec::new(), Vec::<Parameter>::new());
    loop {
        match reader.read_event().unwrap() {
            Event::Start(e) => {
                let name = e.name().as_ref().to_owned();
                let attributes = e.attributes_raw().to_owned();
                match path.len() {
                    1 => head.push(name.clone()),
                    2 if name != "label" && name != "description" => {
                        parameters.push(Parameter { tag: name.clone(), attributes, ..Parameter::default() });
                    }
                    3 => parameters.last_mut().unwrap().inner.push((name.clone(), String::new())),
                    _ => {}
                }
                path.push(name);
            }
            Event::Text(text) if path.len() == 4 => {
                let text = text.to_string();
                parameters.last_mut().unwrap().inner.last_mut().unwrap().1.push_str(&text);
            }
            Event::End(_) => drop(path.pop()),
            Event::Eof => return (head, parameters),
            _ => {}
        }
    }
}

#[test]
fn the_description_keeps_the_rules_of_the_convention() {
    let run = aventail().args(["slicer", "register", "--xml"]).assert().success();
    let xml = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    let (head, parameters) = description(&xml);
    // In the order of the schema (ModuleDescription.xsd).
    let expected = [
        "category",
        "title",
        "description",
        "version",
        "documentation-url",
        "license",
        "contributor",
        "acknowledgements",
    ];
    assert_eq!(head[..8], expected);
    assert!(head[8..].iter().all(|name| name == "parameters") && head.len() == 11);
    let help = aventail().args(["slicer", "register", "--help"]).assert().success();
    let help = String::from_utf8(help.get_output().stdout.clone()).unwrap();
    for p in &parameters {
        for needed in ["name", "label", "description", "longflag"] {
            assert!(!p.get(needed).is_empty(), "{p:?} has no {needed}");
        }
        let flag = format!("--{}", p.get("longflag"));
        assert!(help.contains(&flag), "{flag} is described and not taken");
        let files = ["image", "transform", "file", "directory"].contains(&p.tag.as_str());
        assert_eq!(files, ["input", "output"].contains(&p.get("channel")), "{p:?}");
        if ["image", "transform"].contains(&p.tag.as_str()) {
            assert!(p.attributes.contains("fileExtensions=\"."), "{p:?}");
        }
        let choices: Vec<&String> = p.inner.iter().filter(|(n, _)| n == "element").map(|(_, text)| text).collect();
        assert_eq!(p.tag == "string-enumeration", choices.iter().any(|c| *c == p.get("default")), "{p:?}");
    }
    assert!(parameters.len() >= 15);
}

#[test]
fn the_installed_module_does_what_slicer_asks() {
    let (phantom, modules) = (small_phantom(), folder().join("it's modules"));
    aventail().args(["slicer", "install"]).arg(&modules).assert().success();
    let module = modules.join("AventailRegister");
    let described = Command::new(&module).arg("--xml").output().unwrap();
    assert!(described.status.success() && described.stdout.starts_with(b"<?xml"));
    let at = |name: &str| folder().join(name);
    let (there, back, warped, bones) = (at("t.nrrd"), at("i.nrrd"), at("w.nii.gz"), at("b.nii.gz"));
    let mut run = Command::new(&module);
    run.args(["--threads", "1", "--landmarks", "", "--labels", ""]).arg("--config").arg(quick_settings());
    for (flag, path) in [
        ("--planning", &phantom.planning),
        ("--bones", &phantom.bones),
        ("--fraction", &phantom.fraction),
        ("--transform", &there),
        ("--inverse", &back),
        ("--warped", &warped),
        ("--warpedBones", &bones),
        ("--report", &at("report")),
    ] {
        run.arg(flag).arg(path);
    }
    let done = run.output().unwrap();
    let said = String::from_utf8(done.stdout).unwrap();
    assert!(done.status.success(), "{said}{}", String::from_utf8_lossy(&done.stderr));
    assert!(said.contains("<filter-progress>0.") && said.contains("<filter-progress>1</filter-progress>"), "{said}");
    let same = |a: &Path, b: &str| fs::read(a).unwrap() == fs::read(at("report").join(b)).unwrap();
    assert!(same(&there, "fraction_to_planning.nrrd") && same(&back, "planning_to_fraction.nrrd"));
    let fraction = read_image(&phantom.fraction).unwrap().value;
    assert!(read_field(&there).unwrap().value.grid().matches(fraction.grid(), 1e-3));
    assert!(read_image(&warped).unwrap().value.grid().matches(fraction.grid(), 1e-3));
    assert!(read_label_map(&bones, None).unwrap().value.names.len() > 10);
}

#[test]
fn what_slicer_would_not_ask_is_refused() {
    let phantom = small_phantom();
    let module = |more: &[&str]| {
        let mut run = aventail();
        run.args(["slicer", "register"]).arg("--planning").arg(&phantom.planning).arg("--bones").arg(&phantom.bones);
        run.arg("--fraction").arg(&phantom.fraction).args(more);
        let run = run.assert().code(2);
        String::from_utf8(run.get_output().stderr.clone()).unwrap()
    };
    assert!(module(&[]).contains("no result is chosen"));
    assert!(module(&["--warped", "w.nrrd"]).contains(".nii.gz"));
    assert!(module(&["--transform", "t.nrrd", "--bones="]).contains("--bones"));
    assert!(!Path::new("t.nrrd").exists());
}
