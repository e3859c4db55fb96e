//! The documents: every link leads somewhere, every page is in the book, prose is in lines that a person reads.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Longest line of prose, characters.
const WIDEST: usize = 100;

/// All Markdown files of the project.
fn documents() -> Vec<PathBuf> {
    let mut found = vec![root().join("README.md"), root().join("CHANGELOG.md"), root().join("CONTRIBUTING.md")];
    let mut folders = ["docs", "data", "tests/peers", "workflow", "python"].map(|f| root().join(f)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            match path.extension() {
                _ if path.is_dir() && !name.starts_with('.') && name != "book" => folders.push(path),
                Some(e) if e == "md" => found.push(path),
                _ => {}
            }
        }
    }
    found.sort();
    found
}

/// Lines outside code, with their numbers.
fn prose(text: &str) -> Vec<(usize, &str)> {
    let mut code = false;
    let outside = |(n, line): (usize, &'_ str)| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        (!code && !fence).then_some(n + 1)
    };
    let kept: Vec<usize> = text.lines().enumerate().filter_map(outside).collect();
    let lines: Vec<&str> = text.lines().collect();
    kept.into_iter().map(|n| (n, lines[n - 1])).collect()
}

/// The anchor that a heading has.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = text.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    prose(text).iter().filter(|(_, line)| line.starts_with('#')).map(|(_, line)| anchor(line)).collect()
}

/// Targets of links and pictures in a line.
fn targets(line: &str) -> Vec<&str> {
    line.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(target, _)| target)).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let mut broken = Vec::new();
    let book = root().join("docs").canonicalize().unwrap();
    for path in documents() {
        let text = fs::read_to_string(&path).unwrap();
        for (n, line) in prose(&text) {
            for target in targets(line).into_iter().filter(|t| !t.contains("://") && !t.starts_with("mailto:")) {
                let (file, part) = target.split_once('#').unwrap_or((target, ""));
                let to = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
                // What lies beside the book is not in it.
                let leaves =
                    path.starts_with(root().join("docs")) && !to.canonicalize().is_ok_and(|to| to.starts_with(&book));
                let whole = !leaves
                    && to.exists()
                    && (part.is_empty() || anchors(&fs::read_to_string(&to).unwrap()).contains(part));
                if !whole {
                    broken.push(format!("{}:{n}: {target}", path.strip_prefix(root()).unwrap().display()));
                }
            }
        }
    }
    assert!(broken.is_empty(), "links that lead nowhere:\n{}", broken.join("\n"));
}

#[test]
fn every_page_is_in_the_book() {
    let docs = root().join("docs");
    let summary = fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    let listed: BTreeSet<PathBuf> = summary.lines().flat_map(targets).map(|t| docs.join(t)).collect();
    let pages = documents().into_iter().filter(|p| p.starts_with(&docs) && !p.ends_with("SUMMARY.md"));
    let missing: Vec<PathBuf> = pages.filter(|p| !listed.contains(p)).collect();
    assert!(missing.is_empty(), "not in docs/SUMMARY.md: {missing:?}");
}

#[test]
fn prose_is_in_lines_that_a_person_reads() {
    let mut long = Vec::new();
    for path in documents() {
        let text = fs::read_to_string(&path).unwrap();
        for (n, line) in prose(&text) {
            // A table's row and a lone link cannot be broken.
            let whole = line.trim_start().starts_with('|') || !line.trim().contains(' ') || line.starts_with("![");
            if !whole && line.chars().count() > WIDEST {
                long.push(format!("{}:{n}", path.strip_prefix(root()).unwrap().display()));
            }
        }
    }
    assert!(long.is_empty(), "{} lines are longer than {WIDEST} characters:\n{}", long.len(), long.join("\n"));
}

#[test]
fn the_ten_tasks_name_files_and_things_that_are_there() {
    let text = fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap();
    let section = text.split("## Ten tasks").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: Vec<&str> = section.lines().filter(|l| l.starts_with("| ") && l.contains('`')).collect();
    assert_eq!(rows.len(), 10);
    for row in rows {
        // What stands in backquotes behind the task.
        let answer = row.trim_matches('|').split_once(" | ").unwrap().1;
        let quoted: Vec<&str> = answer.split('`').skip(1).step_by(2).filter(|q| !q.contains("VERB")).collect();
        let (paths, names): (Vec<&str>, Vec<&str>) = quoted.into_iter().partition(|q| q.contains('/'));
        let missing: Vec<&&str> = paths.iter().filter(|p| !root().join(p).exists()).collect();
        assert!(!paths.is_empty() && missing.is_empty(), "{missing:?} of: {row}");
        let sources: Vec<String> = paths.iter().filter_map(|p| fs::read_to_string(root().join(p)).ok()).collect();
        for name in names {
            let known = name.split("::").all(|part| sources.iter().any(|s| words(s).contains(part)));
            assert!(known, "{name} is in no file of: {row}");
        }
    }
}

/// The words of a source file.
fn words(source: &str) -> BTreeSet<&str> {
    source.split(|c: char| !c.is_alphanumeric() && c != '_').collect()
}

/// Settings by their keys, each with its value: tables of tables are told by their keys, lists are values.
fn leaves(prefix: &str, value: &serde_json::Value, found: &mut BTreeMap<String, serde_json::Value>) {
    match value.as_object() {
        Some(table) if !table.is_empty() => {
            let key = |name: &str| if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
            table.iter().for_each(|(name, value)| leaves(&key(name), value, found));
        }
        _ => drop(found.insert(prefix.to_owned(), value.clone())),
    }
}

#[test]
fn every_setting_stands_in_its_table_with_its_default_and_when_to_touch_it() {
    let text = fs::read_to_string(root().join("docs/settings.md")).unwrap();
    let cells = |line: &str| line.trim_matches('|').split(" | ").map(|c| c.trim().to_owned()).collect::<Vec<_>>();
    // Before the table of the thesis's stages, whose rows name several keys.
    let before = text.split("The stages of the thesis").next().unwrap();
    let rows = before.lines().filter(|l| l.starts_with("| `")).map(cells);
    let told: BTreeMap<String, Vec<String>> = rows.map(|row| (row[0].trim_matches('`').to_owned(), row)).collect();
    let mut settings = BTreeMap::new();
    leaves("", &serde_json::to_value(aventail::config::Config::default()).unwrap(), &mut settings);
    for name in ["region.label", "region.box_mm"] {
        settings.entry(name.to_owned()).or_insert(serde_json::Value::Null);
    }
    for (key, value) in &settings {
        let general = key.split_once('.').map(|(room, _)| format!("{room}.*"));
        let row = told.get(key).or_else(|| told.get(&general?)).unwrap_or_else(|| panic!("{key} = {value}: no row"));
        assert!(row.len() == 4 && row.iter().all(|cell| !cell.is_empty()), "{key}: {row:?}");
        let default = row[1].trim_matches('`');
        let same = match value {
            serde_json::Value::Number(n) => default.parse::<f64>().ok() == n.as_f64(),
            serde_json::Value::Bool(b) => default == b.to_string(),
            serde_json::Value::String(s) => default == format!("\"{s}\""),
            serde_json::Value::Array(list) if list.first().is_some_and(|v| !v.is_object()) => {
                serde_json::from_str::<serde_json::Value>(default).is_ok_and(|told| alike(&told, value))
            }
            // Empty, or a list of tables: told in words.
            _ => true,
        };
        assert!(
            same || row[0].contains('*') || key.starts_with("verdict."),
            "{key} is {value}, docs/settings.md says {default}"
        );
    }
    let unknown: Vec<&String> = told.keys().filter(|k| !k.ends_with(".*") && !settings.contains_key(*k)).collect();
    assert!(unknown.is_empty(), "docs/settings.md tells of settings that are none: {unknown:?}");
}

/// Lists whose numbers are equal, whether they are written with a point or not.
fn alike(a: &serde_json::Value, b: &serde_json::Value) -> bool {
    match (a.as_array(), b.as_array()) {
        (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| alike(a, b)),
        _ => a == b || a.as_f64().is_some() && a.as_f64() == b.as_f64(),
    }
}

#[test]
fn every_direct_dependency_has_its_reason() {
    let manifest: String = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let section = manifest.split("[workspace.dependencies]").nth(1).unwrap().split("\n[").next().unwrap();
    let names = section.lines().filter_map(|l| l.split_once(" = ")).map(|(name, _)| name);
    let text = fs::read_to_string(root().join("docs/architecture.md")).unwrap();
    let table = text.split("## Direct dependencies").nth(1).unwrap();
    let told: BTreeSet<&str> = table
        .lines()
        .filter_map(|l| l.strip_prefix("| ")?.split(" | ").next())
        .flat_map(|cell| cell.trim_start_matches("dev: ").split(", "))
        .map(|name| name.split(' ').next().unwrap_or_default())
        .collect();
    let missing: Vec<&str> = names.filter(|n| !n.starts_with("aventail") && !told.contains(n)).collect();
    assert!(missing.is_empty(), "docs/architecture.md gives no reason for {missing:?}");
}

/// What stands in backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// `docs/method.md` names constants with their values and the files that hold them.
#[test]
fn constants_of_the_method_are_those_of_the_code() {
    let text = fs::read_to_string(root().join("docs/method.md")).unwrap();
    let list = text.split("## Constants").nth(1).and_then(|rest| rest.split("\n## ").next()).unwrap();
    let (mut checked, mut wrong) = (0, Vec::new());
    for item in list.split("\n- ").skip(1) {
        let file = quoted(item).next().unwrap();
        let code = fs::read_to_string(root().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        let pairs = item.split('`').skip(2).collect::<Vec<_>>();
        for pair in pairs[1..].chunks_exact(2) {
            let [name, value] = [pair[0], pair[1].trim().trim_end_matches(',')];
            let held = code.split(&format!("const {name}: ")).nth(1).and_then(|rest| rest.split(" = ").nth(1));
            let held = held.and_then(|rest| rest.split(';').next()).unwrap_or_default().replace('_', "");
            if held.parse::<f64>().ok() != Some(value.parse().unwrap_or(f64::NAN)) {
                wrong.push(format!("{file}: {name} is {held:?}, the page says {value}"));
            }
            checked += 1;
        }
    }
    assert!(checked > 40 && wrong.is_empty(), "{checked} checked; {wrong:#?}");
}

/// Paths of the project in backticks exist.
#[test]
fn paths_in_the_documents_are_there() {
    let ours = ["src/", "tests/", "docs/", "data/", "workflow/", "python/", "benches/", "fuzz/", ".ci/"];
    let odd = |path: &str| {
        path.contains("VERB") || path.contains([' ', '*', '{', '<', '(', '=', ',', ':']) || path.contains("..")
    };
    let mut missing = Vec::new();
    for file in documents() {
        let text = fs::read_to_string(&file).unwrap();
        let own = text.split("```").step_by(2).collect::<String>();
        let named = quoted(&own).filter(|path| ours.iter().any(|start| path.starts_with(start)) && !odd(path));
        let gone = named.map(|path| path.split('#').next().unwrap_or(path)).filter(|path| !root().join(path).exists());
        missing.extend(gone.map(|path| format!("{}: {path}", file.display())));
    }
    assert!(missing.is_empty(), "{missing:#?}");
}

/// Pages of figures: each of their tables stands in docs/data, or a test makes it.
const FIGURES: [&str; 4] = ["validation.md", "performance.md", "study.md", "real.md"];

/// A table of docs/data in Markdown, its first row the header; and what its first lines do not say of where it comes from.
fn table_of(path: &Path) -> (String, Vec<&'static str>) {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let said = |key: &str| {
        let start = format!("# {key}: ");
        text.lines().any(|line| line.strip_prefix(&start).is_some_and(|rest| !rest.trim().is_empty()))
    };
    let lacking = ["command", "date", "machine"].into_iter().filter(|key| !said(key)).collect();
    let mut reader = csv::ReaderBuilder::new().has_headers(false).comment(Some(b'#')).from_reader(text.as_bytes());
    let mut table = String::new();
    for (n, row) in reader.records().enumerate() {
        let row = row.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let cells = row.iter().map(|cell| if cell.is_empty() { " |".to_owned() } else { format!(" {cell} |") });
        table += &format!("|{}\n", cells.collect::<String>());
        if n == 0 {
            table += &format!("|{}\n", "---|".repeat(row.len()));
        }
    }
    (table, lacking)
}

/// The name in `<!-- table: NAME -->`.
fn table_named(line: &str) -> Option<&str> {
    line.strip_prefix("<!-- table: ")?.strip_suffix(" -->")
}

/// A page with its tables as docs/data has them, and the files that they come from.
fn rendered(page: &Path, text: &str) -> (String, Vec<PathBuf>) {
    let (mut made, mut files) = (String::new(), Vec::new());
    let mut inside = false;
    for line in text.lines() {
        inside &= line != "<!-- end -->";
        if !inside {
            made += &format!("{line}\n");
        }
        if let Some(name) = table_named(line) {
            let file = page.parent().unwrap_or(page).join(name);
            made += &table_of(&file).0;
            files.push(file);
            inside = true;
        }
    }
    assert!(!inside, "{}: a table without `<!-- end -->`", page.display());
    (made, files)
}

/// What a page says and docs/data does not is an old figure. After a change of the data:
/// `AVENTAIL_WRITE_DOCS=1 cargo test --release --test all docs`.
#[test]
fn tables_of_the_pages_are_those_of_their_data() {
    let docs = root().join("docs");
    let mut used = BTreeSet::new();
    for page in documents().into_iter().filter(|path| path.starts_with(&docs)) {
        let text = fs::read_to_string(&page).unwrap();
        if !text.lines().any(|line| table_named(line).is_some()) {
            continue;
        }
        let (made, files) = rendered(&page, &text);
        if made != text && std::env::var_os("AVENTAIL_WRITE_DOCS").is_some() {
            fs::write(&page, &made).unwrap();
        } else {
            assert!(
                made == text,
                "{} is not what docs/data says; this test's comment says how to write it",
                page.display()
            );
        }
        used.extend(files);
    }
    let data = fs::read_dir(docs.join("data")).unwrap().map(|entry| entry.unwrap().path());
    for path in data.filter(|path| path.extension().is_some_and(|e| e == "csv")) {
        let lacking = table_of(&path).1;
        assert!(lacking.is_empty(), "{}: no `# ...: ` of {lacking:?}", path.display());
        assert!(used.contains(&path), "{}: in no page", path.display());
    }
}

#[test]
fn no_table_of_figures_stands_without_its_data() {
    let mut bare = Vec::new();
    for page in FIGURES {
        let text = fs::read_to_string(root().join("docs").join(page)).unwrap();
        let mut made = false;
        for (n, line) in text.lines().enumerate() {
            if line.starts_with("<!-- ") {
                made = !line.starts_with("<!-- end");
            } else if line.starts_with('|') && !made {
                bare.push(format!("docs/{page}:{}", n + 1));
            }
        }
    }
    assert!(bare.is_empty(), "rows of tables outside `<!-- table: data/NAME.csv -->` and `<!-- end -->`: {bare:?}");
}

/// Where the figures in prose come from: docs/data/figures.toml.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Figures {
    measured: Vec<Measured>,
    repeated: Vec<Repeated>,
    given: Vec<Given>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Measured {
    page: String,
    command: String,
    date: String,
    machine: String,
    commit: String,
    figures: Vec<String>,
}

/// Figures of a table of docs/data, rounded.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Repeated {
    page: String,
    table: String,
    figures: Vec<String>,
}

/// Sizes, settings, limits, versions, dates: no results.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    page: String,
    figures: Vec<String>,
}

/// A page's prose in one line: without code blocks, tables, comments and targets of links.
fn flowing(text: &str) -> String {
    let lines = prose(text).into_iter().map(|(_, line)| line);
    let own = lines.filter(|line| !line.starts_with('|') && !line.starts_with("<!-- "));
    let line = own.flat_map(str::split_whitespace).collect::<Vec<_>>().join(" ");
    let mut parts = line.split("](");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |line, rest| line + "]" + rest.split_once(')').map_or("", |(_, rest)| rest))
}

/// Figures: words outside backticks whose first letter or digit is a digit (`0.25`, `(1.8)`, `-500`; not `C4`).
fn figures(prose: &str) -> impl Iterator<Item = &str> {
    let digit_first = |word: &&str| word.chars().find(|c| c.is_alphanumeric()).is_some_and(|c| c.is_ascii_digit());
    prose.split('`').step_by(2).flat_map(str::split_whitespace).filter(digit_first)
}

/// Whether a figure is one of a table's numbers, rounded as the figure is.
fn is_in(figure: &str, table: &str) -> bool {
    let figure = figure.trim_matches(|c: char| !c.is_ascii_digit());
    let decimals = figure.split_once('.').map_or(0, |(_, behind)| behind.len());
    let rows = table.lines().filter(|line| !line.starts_with('#'));
    let mut numbers = rows.flat_map(|line| line.split(|c: char| !c.is_ascii_digit() && c != '.'));
    numbers.any(|n| n.parse::<f64>().is_ok_and(|n| format!("{n:.decimals$}") == figure))
}

/// Each piece of docs/data/figures.toml stands once on its page, and is struck out; no figure may be left.
#[test]
fn figures_in_prose_are_those_of_their_data() {
    let data = root().join("docs/data");
    let said: Figures = toml::from_str(&fs::read_to_string(data.join("figures.toml")).unwrap()).unwrap();
    let mut wrong = Vec::new();
    for Measured { page, command, date, machine, commit, figures } in &said.measured {
        if [command, date, machine, commit].iter().any(|value| value.trim().is_empty()) {
            wrong.push(format!("{page}: no command, date, machine or commit of {figures:?}"));
        }
    }
    for Repeated { page, table, figures: pieces } in &said.repeated {
        let values = fs::read_to_string(data.join(table)).unwrap_or_else(|e| panic!("{table}: {e}"));
        let other = pieces.iter().flat_map(|piece| figures(piece)).filter(|figure| !is_in(figure, &values));
        wrong.extend(other.map(|figure| format!("{page}: {figure} is not in {table}")));
    }
    let measured = said.measured.iter().map(|m| (&m.page, &m.figures));
    let repeated = said.repeated.iter().map(|r| (&r.page, &r.figures));
    let given = said.given.iter().map(|g| (&g.page, &g.figures));
    let pages = FIGURES.iter().map(|page| format!("docs/{page}")).chain(["README.md".to_owned()]);
    let text_of = |page: &String| flowing(&fs::read_to_string(root().join(page)).unwrap());
    let mut left: BTreeMap<String, String> = pages.map(|page| (page.clone(), text_of(&page))).collect();
    for (page, pieces) in measured.chain(repeated).chain(given) {
        let text = left.get_mut(page).unwrap_or_else(|| panic!("{page} is no page of figures"));
        for piece in pieces {
            match text.matches(piece.as_str()).count() {
                1 => *text = text.replace(piece.as_str(), " "),
                times => wrong.push(format!("{page}: stands there {times} times: {piece}")),
            }
        }
    }
    for (page, text) in &left {
        wrong.extend(figures(text).map(|figure| format!("{page}: not in docs/data/figures.toml: {figure}")));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Nobody reads more: what a page gains another loses.
#[test]
fn the_documents_stay_short() {
    let of = |path: &Path| path.starts_with(root().join("docs")) || path == root().join("README.md");
    let words = |path: &PathBuf| fs::read_to_string(path).unwrap().split_whitespace().count();
    let all: usize = documents().iter().filter(|path| of(path)).map(words).sum();
    assert!(all < 25_000, "{all} words in README and docs");
}
