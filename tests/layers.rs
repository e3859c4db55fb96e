//! The layout is what `src/lib.rs` says: rooms import only from lower ranks, crates hold whole ranks and depend only on lower
//! ones, one room knows NIfTI, files stay short.
//!
//! Sources are read as tokens, so comments, strings and line breaks inside `use` cannot mislead; tests are left out.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Rooms by rank, as the table in `src/lib.rs`.
const RANKS: [&[&str]; 13] = [
    &["error", "findings", "warning", "parallel", "progress", "runtime", "stats"],
    &["geometry"],
    &["volume"],
    &["field", "body", "view"],
    &["skeleton", "chainmail", "evaluate", "dose", "sampling"],
    &["fit", "plausibility", "postures", "refine", "comparator"],
    &["config"],
    &["pipeline"],
    &["io", "phantom"],
    &["provenance", "concepts"],
    &["report"],
    &["session", "benchmark"],
    &["cli"],
];

/// The crates below `src`, lowest first, and their rooms; `cli` is the program's own. A crate takes from earlier ones only.
const CRATES: [(&str, &[&str]); 10] = [
    ("base", &["error", "findings", "warning", "parallel", "progress", "runtime", "stats", "geometry", "volume"]),
    ("fields", &["field", "body", "view"]),
    ("measures", &["evaluate", "dose", "sampling"]),
    ("tissue", &["chainmail", "refine", "comparator"]),
    ("bones", &["skeleton", "fit", "plausibility", "postures"]),
    ("registration", &["config", "pipeline"]),
    ("scenes", &["phantom", "concepts"]),
    ("formats", &["io"]),
    ("pages", &["provenance", "report"]),
    ("sessions", &["session", "benchmark"]),
];

/// Imports inside rank 0 that are meant: a runtime shows progress and reports errors, errors and warnings are of findings.
const EXCEPTIONS: [(&str, &str); 4] =
    [("runtime", "progress"), ("runtime", "error"), ("error", "findings"), ("warning", "findings")];

/// Greatest length of a source file in lines, tests left out.
const LONGEST: usize = 450;

/// Median length of a source file in lines, tests left out.
const MEDIAN: usize = 150;

/// A source file: its path inside `src`, and inside its crate, and its code without tests.
struct Source {
    file: PathBuf,
    path: PathBuf,
    code: Code,
    lines: usize,
}

/// What the rules look at.
#[derive(Debug, Default, PartialEq)]
struct Code {
    /// Rooms that the code names through `crate::` or `super::`.
    rooms: BTreeSet<String>,
    /// Crates and local names that begin a path or a `use`.
    heads: BTreeSet<String>,
    /// What follows paths of `super`, with their number: `super::super::grid` is (2, "grid").
    ups: BTreeSet<(usize, String)>,
    /// Names that this module hands on from modules of its own, each with the module: `pub use grid::Grid`.
    exports: BTreeMap<String, String>,
    /// Lines that call `.unwrap()`.
    unwraps: Vec<usize>,
    /// Modules that exist in tests only and lie in files of their own.
    test_modules: Vec<String>,
    /// Lines of test modules in this file.
    test_lines: usize,
}

impl Code {
    /// `depth`: how many `super` lead from this file's module to the crate root.
    fn of(text: &str, depth: usize) -> Self {
        let mut code = Self::default();
        code.walk(TokenStream::from_str(text).expect("the file compiles, so it has tokens"), depth);
        code
    }

    fn walk(&mut self, stream: TokenStream, depth: usize) {
        let tokens: Vec<TokenTree> = stream.into_iter().collect();
        let mut n = 0;
        while n < tokens.len() {
            if is_test_attribute(&tokens[n..]) {
                n = self.skip_test(&tokens, n + 2);
                continue;
            }
            match &tokens[n] {
                TokenTree::Group(group) => {
                    let module = n >= 2 && word(&tokens[n - 2]).is_some_and(|w| w == "mod");
                    self.walk(group.stream(), depth + usize::from(module && group.delimiter() == Delimiter::Brace));
                }
                TokenTree::Ident(name) => self.path(&name.to_string(), &tokens, n, depth),
                _ => {}
            }
            n += 1;
        }
    }

    /// Notes where a path that begins at token `n` leads.
    fn path(&mut self, name: &str, tokens: &[TokenTree], n: usize, depth: usize) {
        if name == "unwrap" && n > 0 && punct(&tokens[n - 1], '.') {
            self.unwraps.push(tokens[n].span().start().line);
        }
        if n >= 2 && punct(&tokens[n - 1], ':') && punct(&tokens[n - 2], ':') {
            // `use ::name` begins a path, `room::name` goes on with one.
            if n == 2 || word(&tokens[n - 3]).is_some_and(|w| w == "use") {
                self.heads.insert(format!("::{name}"));
            }
            return;
        }
        if n > 0 && word(&tokens[n - 1]).is_some_and(|w| w == "use") {
            self.export(name, tokens, n);
        }
        if n > 0 && word(&tokens[n - 1]).is_some_and(|w| w == "use") || after_colons(tokens, n).is_some() {
            self.heads.insert(name.to_owned());
        }
        let (mut at, mut up) = (n, 0);
        while word(&tokens[at]).is_some_and(|w| w == "super") && up < depth {
            up += 1;
            match after_colons(tokens, at) {
                Some(next) => at = next,
                None => return,
            }
        }
        if up > 0 {
            self.ups.extend(names_at(&tokens[at]).into_iter().map(|name| (up, name)));
        }
        let first = match name {
            "crate" => after_colons(tokens, n),
            "super" if up == depth => Some(at),
            _ => None,
        };
        let rooms = first.map_or_else(Vec::new, |at| names_at(&tokens[at]));
        rooms.iter().for_each(|room| self.room(room));
    }

    /// Notes what `use name::...` at token `n` hands on, where it does.
    fn export(&mut self, name: &str, tokens: &[TokenTree], n: usize) {
        let public = n >= 2
            && (word(&tokens[n - 2]).is_some_and(|w| w == "pub") || matches!(&tokens[n - 2], TokenTree::Group(_)));
        let Some(at) = after_colons(tokens, n).filter(|_| public) else { return };
        self.exports.extend(names_at(&tokens[at]).into_iter().map(|symbol| (symbol, name.to_owned())));
    }

    fn room(&mut self, name: &str) {
        // The crate root re-exports these two.
        self.rooms.insert(if matches!(name, "Error" | "Result") { "error".into() } else { name.to_owned() });
    }

    /// Leaves out the item that follows `#[cfg(test)]`; returns the position after it.
    fn skip_test(&mut self, tokens: &[TokenTree], mut n: usize) -> usize {
        let start = tokens[n - 2].span().start().line;
        let mut module = None;
        while n < tokens.len() {
            if word(&tokens[n]).is_some_and(|w| w == "mod") {
                module = tokens.get(n + 1).and_then(word);
            }
            let braces = matches!(&tokens[n], TokenTree::Group(g) if g.delimiter() == Delimiter::Brace);
            let end = punct(&tokens[n], ';');
            if end && let Some(name) = module.take() {
                self.test_modules.push(name);
            }
            n += 1;
            if braces || end {
                self.test_lines += tokens[n - 1].span().end().line + 1 - start;
                break;
            }
        }
        n
    }
}

/// The name that a token is, or those that begin the parts of a group.
fn names_at(token: &TokenTree) -> Vec<String> {
    match token {
        TokenTree::Group(group) => {
            let list: Vec<TokenTree> = group.stream().into_iter().collect();
            list.split(|t| punct(t, ',')).filter_map(|part| part.first().and_then(word)).collect()
        }
        other => word(other).into_iter().collect(),
    }
}

fn word(token: &TokenTree) -> Option<String> {
    if let TokenTree::Ident(name) = token { Some(name.to_string()) } else { None }
}

fn punct(token: &TokenTree, mark: char) -> bool {
    matches!(token, TokenTree::Punct(p) if p.as_char() == mark)
}

/// Position of the token after `::` that follows token `n`.
fn after_colons(tokens: &[TokenTree], n: usize) -> Option<usize> {
    let colons = n + 3 < tokens.len() && punct(&tokens[n + 1], ':') && punct(&tokens[n + 2], ':');
    colons.then_some(n + 3)
}

fn is_test_attribute(tokens: &[TokenTree]) -> bool {
    let [hash, TokenTree::Group(group), ..] = tokens else { return false };
    punct(hash, '#') && group.stream().to_string().replace(' ', "") == "cfg(test)"
}

/// Every source file of the library outside tests.
fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    collect(&root, &mut files);
    let mut sources: Vec<Source> = files
        .iter()
        .map(|file| {
            let file = file.strip_prefix(&root).expect("it was found below src");
            let path = in_crate(file);
            let text = fs::read_to_string(root.join(file)).expect("sources are text");
            let code = Code::of(&text, depth(&path));
            let lines = text.lines().count() - code.test_lines;
            Source { file: file.to_path_buf(), path, code, lines }
        })
        .collect();
    let tests: Vec<PathBuf> = sources
        .iter()
        .flat_map(|s| {
            let folder = s.path.parent().expect("a file lies in a folder").to_path_buf();
            // Modules of a file that is no `mod.rs` lie in the folder of its name.
            let own = s.path.with_extension("");
            let places = |m: &String| [folder.join(m), own.join(m)];
            s.code.test_modules.iter().flat_map(places).collect::<Vec<_>>()
        })
        .collect();
    sources.retain(|s| !tests.iter().any(|t| s.path.starts_with(t) || s.path == t.with_extension("rs")));
    assert!(sources.len() > 50, "only {} sources were found", sources.len());
    sources
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder).expect("a folder").map(|e| e.expect("an entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

/// How many `super` lead from a file to the crate root.
fn depth(path: &Path) -> usize {
    let parts = path.components().count();
    if path.ends_with("mod.rs") { parts - 1 } else { parts }
}

/// The path of a source file inside its crate.
fn in_crate(file: &Path) -> PathBuf {
    let of_crate = CRATES.iter().find_map(|(name, _)| file.strip_prefix(name).ok());
    of_crate.unwrap_or(file).to_path_buf()
}

/// The room that a file belongs to: its first folder, or the file itself.
fn room(path: &Path) -> String {
    let first = path.components().next().expect("a path has parts");
    Path::new(&first).with_extension("").display().to_string()
}

fn rank(room: &str) -> Option<usize> {
    RANKS.iter().position(|rooms| rooms.contains(&room))
}

/// What is wrong with `room` importing these rooms.
fn violations(room: &str, imports: &BTreeSet<String>) -> Vec<String> {
    let Some(own) = rank(room) else { return vec![format!("room {room} has no rank")] };
    let wrong = imports
        .iter()
        .filter(|other| *other != room && !EXCEPTIONS.contains(&(room, other.as_str())))
        .filter_map(|other| match rank(other) {
            None => Some(format!("{room} imports {other}, which is no room")),
            Some(rank) if rank >= own => Some(format!("{room} (rank {own}) imports {other} (rank {rank})")),
            Some(_) => None,
        });
    wrong.collect()
}

#[test]
fn rooms_import_only_from_lower_ranks() {
    let mut wrong = Vec::new();
    for s in sources().iter().filter(|s| !["lib.rs", "main.rs"].iter().any(|f| s.path == Path::new(f))) {
        // Lower crates are named at a crate's root only, so that `crate::room` is the one way to a room.
        let around = s.code.heads.iter().filter(|h| h.trim_start_matches(':').starts_with("aventail"));
        wrong.extend(around.map(|h| format!("{}: names the crate {h}", s.file.display())));
        wrong.extend(violations(&room(&s.path), &s.code.rooms).iter().map(|v| format!("{}: {v}", s.path.display())));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Where a file's module lies: folders and its own name, without the crate.
fn module(path: &Path) -> Vec<String> {
    let whole = path.with_extension("");
    let parts = whole.components().map(|c| c.as_os_str().to_string_lossy().into_owned());
    let mut parts: Vec<String> = parts.collect();
    parts.pop_if(|last| last == "mod");
    parts
}

/// Who imports whom among the files and folders of each folder: folder, from, to. The folder's own `mod.rs` is its head: what it
/// holds is not counted, what it hands on counts as the file that it comes from.
fn imports_by_folder(sources: &[Source]) -> BTreeMap<PathBuf, BTreeSet<(String, String)>> {
    let of_crate = |s: &Source| s.file.parent().map(Path::to_owned).unwrap_or_default();
    let heads: BTreeMap<PathBuf, &Code> =
        sources.iter().filter(|s| s.path.ends_with("mod.rs")).map(|s| (of_crate(s), &s.code)).collect();
    let mut found: BTreeMap<PathBuf, BTreeSet<(String, String)>> = BTreeMap::new();
    for s in sources {
        let own = module(&s.path);
        for (up, name) in &s.code.ups {
            let Some(from) = own.len().checked_sub(*up).and_then(|n| own.get(n)) else { continue };
            // The folder in which both lie, of which `from` is a part.
            let levels = if s.path.ends_with("mod.rs") { *up } else { *up - 1 };
            let Some(folder) = of_crate(s).ancestors().nth(levels).map(Path::to_owned) else { continue };
            let Some(head) = heads.get(&folder) else { continue };
            let is_file = |name: &str| {
                sources.iter().any(|o| {
                    o.file == folder.join(name).with_extension("rs") || o.file == folder.join(name).join("mod.rs")
                })
            };
            let to = if is_file(name) { Some(name) } else { head.exports.get(name) };
            if let Some(to) = to.filter(|to| *to != from) {
                found.entry(folder).or_default().insert((from.clone(), to.clone()));
            }
        }
    }
    found
}

/// What is left when files that import none of the others are taken away, again and again: those in circles, and those that import
/// them.
fn in_circles(imports: &BTreeSet<(String, String)>) -> BTreeSet<(String, String)> {
    let mut left = imports.clone();
    loop {
        let from: BTreeSet<String> = left.iter().map(|(from, _)| from.clone()).collect();
        let before = left.len();
        left.retain(|(_, to)| from.contains(to));
        if left.len() == before {
            return left;
        }
    }
}

#[test]
fn files_of_a_folder_import_only_downwards() {
    let circles = imports_by_folder(&sources()).into_iter().map(|(folder, imports)| (folder, in_circles(&imports)));
    let wrong: Vec<String> = circles
        .filter(|(_, circle)| !circle.is_empty())
        .map(|(folder, circle)| {
            let edges: Vec<String> = circle.iter().map(|(a, b)| format!("  {a} -> {b}")).collect();
            format!("{}:\n{}", folder.display(), edges.join("\n"))
        })
        .collect();
    assert!(wrong.is_empty(), "files import each other in circles:\n{}", wrong.join("\n"));
}

/// The rooms that a crate's root holds.
fn rooms_of(lib: &Path) -> Vec<String> {
    let lib = fs::read_to_string(lib).expect("a crate has a root");
    lib.lines().filter_map(|l| Some(l.strip_prefix("pub mod ")?.strip_suffix(';')?.to_owned())).collect()
}

#[test]
fn every_room_has_the_crate_and_the_rank_that_it_says() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut rooms = Vec::new();
    for (name, expected) in CRATES.iter().copied().chain([("", ["cli"].as_slice())]) {
        let found = rooms_of(&root.join(name).join("lib.rs"));
        assert_eq!(
            BTreeSet::from_iter(&found),
            expected.iter().map(|e| e.to_string()).collect::<Vec<_>>().iter().collect()
        );
        rooms.extend(found.into_iter().map(|room| (name, room)));
    }
    assert_eq!(rooms.len(), RANKS.concat().len(), "{rooms:?}");
    for (name, room) in rooms {
        let rank = rank(&room).unwrap_or_else(|| panic!("{room} has no rank in this test"));
        if rank > 0 {
            let text = fs::read_to_string(root.join(name).join(&room).join("mod.rs")).unwrap();
            assert!(
                text.starts_with(&format!("//! Rank {rank}: ")),
                "{room}/mod.rs does not begin with `//! Rank {rank}: `"
            );
        }
    }
}

/// The crates of ours that a manifest names as dependencies, and apart those that only its tests need.
fn dependencies(manifest: &str) -> [BTreeSet<String>; 2] {
    let (mut found, mut section) = ([BTreeSet::new(), BTreeSet::new()], "");
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line;
        } else if let Some(name) = line.strip_prefix("aventail-").and_then(|l| l.split(['.', ' ']).next()) {
            found[usize::from(section != "[dependencies]")].insert(name.to_owned());
        }
    }
    found
}

#[test]
fn crates_depend_only_on_lower_ones() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let folders = fs::read_dir(&root).unwrap().map(|e| e.unwrap().path()).filter(|p| p.join("Cargo.toml").is_file());
    assert_eq!(folders.count(), CRATES.len(), "a crate below src that this test does not know");
    for (n, (name, _)) in CRATES.iter().enumerate() {
        let manifest = fs::read_to_string(root.join(name).join("Cargo.toml")).unwrap();
        let below: BTreeSet<String> = CRATES[..n].iter().map(|c| c.0.to_owned()).collect();
        let [used, tests] = dependencies(&manifest);
        assert!(used.is_subset(&below), "{name} depends on {:?}", used.difference(&below));
        assert!(!tests.contains(*name), "{name} tests itself from outside");
        // What a crate imports it says at its root, so that `crate::room` leads to the crate that holds it.
        let lib = fs::read_to_string(root.join(name).join("lib.rs")).unwrap();
        for other in used {
            assert!(lib.contains(&format!("use aventail_{other}::")), "{name} depends on {other} and does not use it");
        }
    }
}

#[test]
fn one_room_names_the_nifti_crate() {
    for s in sources().iter().filter(|s| !s.path.starts_with("io/nifti")) {
        // In `io`, `nifti` without leading colons is the module of that name.
        let names = s.code.heads.contains("::nifti") || s.code.heads.contains("nifti") && !s.path.starts_with("io");
        assert!(!names, "{} names the nifti crate", s.path.display());
    }
    let users: Vec<String> = sources()
        .iter()
        .filter(|s| s.path.starts_with("io/nifti") && s.code.heads.contains("::nifti"))
        .map(|s| s.path.display().to_string())
        .collect();
    assert_eq!(users.len(), 1, "files that name the nifti crate: {users:?}");
}

#[test]
fn files_are_short() {
    let sources = sources();
    let long: Vec<String> = sources
        .iter()
        .filter(|s| s.lines > LONGEST)
        .map(|s| format!("{}: {} lines", s.path.display(), s.lines))
        .collect();
    assert!(long.is_empty(), "longer than {LONGEST} lines: {long:?}");
    let mut lines: Vec<usize> = sources.iter().map(|s| s.lines).collect();
    lines.sort_unstable();
    let median = lines[lines.len() / 2];
    assert!(median <= MEDIAN, "the median file has {median} lines");
}

#[test]
fn nothing_unwraps_outside_tests() {
    for s in sources() {
        assert!(s.code.unwraps.is_empty(), "{}: unwrap in lines {:?}", s.path.display(), s.code.unwraps);
    }
}

#[test]
fn every_file_says_what_it_is_for() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for s in sources() {
        let text = fs::read_to_string(root.join(&s.file)).unwrap();
        assert!(text.starts_with("//! "), "{} does not open with its purpose", s.path.display());
    }
}

#[test]
fn every_file_of_tests_is_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |name: &str| fs::read_to_string(root.join(name)).expect("the file is there");
    let (all, manifest) = (read("tests/all.rs"), read("Cargo.toml"));
    let mut files = 0;
    for entry in fs::read_dir(root.join("tests")).expect("the folder can be listed") {
        let path = entry.expect("the folder can be listed").path();
        let name = path.file_stem().and_then(|n| n.to_str()).unwrap_or_default();
        if path.extension().is_some_and(|e| e == "rs") || path.join("main.rs").exists() {
            let own = manifest.contains(&format!("[[test]]\nname = \"{name}\"\n"));
            assert!(own || all.contains(&format!("\nmod {name};\n")), "{} is in no test program", path.display());
            files += 1;
        }
    }
    assert!(files > 15, "{files} files");
}

#[test]
fn the_manifest_reader_tells_tests_apart() {
    let manifest =
        "[dependencies]\naventail-base.workspace = true\nserde = \"1\"\n[dev-dependencies]\naventail-x = 1\n";
    let names = |list: &[&str]| list.iter().map(|n| n.to_string()).collect::<BTreeSet<_>>();
    assert_eq!(dependencies(manifest), [names(&["base"]), names(&["x"])]);
    assert_eq!(in_crate(Path::new("tissue/chainmail/dial.rs")), Path::new("chainmail/dial.rs"));
    assert_eq!(in_crate(Path::new("cli/mod.rs")), Path::new("cli/mod.rs"));
}

#[test]
fn circles_are_found() {
    let edges =
        |list: &[(&str, &str)]| list.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect::<BTreeSet<_>>();
    assert!(in_circles(&edges(&[("a", "b"), ("b", "c"), ("a", "c")])).is_empty());
    let found = in_circles(&edges(&[("a", "b"), ("b", "c"), ("c", "b"), ("c", "d")]));
    assert!(found.contains(&("b".into(), "c".into())) && !found.contains(&("c".into(), "d".into())));
    let code =
        Code::of("use super::grid::Grid; pub use volume::{Volume, Mask}; fn f() { super::super::other::g() }", 3);
    assert!(code.ups.contains(&(1, "grid".into())) && code.ups.contains(&(2, "other".into())));
    assert_eq!(code.exports.get("Mask"), Some(&"volume".to_owned()));
}

#[test]
fn the_checker_sees_what_it_should() {
    let text = r#"
        //! crate::comment
        use crate::{error::Result, pipeline::{Case, Outcome}, Error};
        use super::super::report::page;
        use ::nifti::{NiftiObject, NiftiHeader};
        use csv::Reader;
        /// crate::documentation
        fn f() -> crate::cli::Args { let s = "crate::text"; g(vec![crate::fit::x()]).unwrap() }
        mod inner { use super::super::super::io; use super::sibling; }
        #[cfg(test)]
        mod tests {
            use crate::hidden::X;
            fn h() { x.unwrap() }
        }
        #[cfg(test)]
        mod outside;
        use crate::volume::Mask;
    "#;
    let code = Code::of(text, 2);
    let rooms: Vec<&str> = code.rooms.iter().map(String::as_str).collect();
    assert_eq!(rooms, ["cli", "error", "fit", "io", "pipeline", "report", "volume"]);
    assert!(code.heads.contains("::nifti") && code.heads.contains("csv") && !code.heads.contains("Reader"));
    assert_eq!((code.unwraps, code.test_modules, code.test_lines), (vec![8], vec!["outside".to_owned()], 7));
    let found = violations("field", &code.rooms);
    assert_eq!(found.len(), 5, "{found:?}");
    assert!(found.contains(&"field (rank 3) imports cli (rank 12)".to_owned()));
    assert!(violations("runtime", &["progress".to_owned()].into()).is_empty());
    assert_eq!(violations("progress", &["runtime".to_owned()].into()).len(), 1);
    assert_eq!(violations("skeleton", &["chainmail".to_owned()].into()).len(), 1, "equal ranks");
    assert_eq!(violations("io", &["elsewhere".to_owned()].into()), ["io imports elsewhere, which is no room"]);
}
