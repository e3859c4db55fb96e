//! Findings: what the table holds is raised by the sources, in the way that it says, and `docs/refusals.md` is made from it.
//! After a change of the table, write the page anew: `AVENTAIL_WRITE_DOCS=1 cargo test --release --test findings`.

#![expect(clippy::unwrap_used, reason = "a test that cannot read the sources fails")]

use aventail::findings::{FINDINGS, Told};
use proc_macro2::{TokenStream, TokenTree};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::str::FromStr;

/// Constants of findings that a file warns of, or refuses with, outside its tests.
#[derive(Default)]
struct Raised {
    warned: BTreeSet<String>,
    refused: BTreeSet<String>,
}

impl Raised {
    fn walk(&mut self, folder: &Path) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("tests") && !path.ends_with("findings") {
                self.walk(&path);
            } else if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests.rs") {
                self.read(TokenStream::from_str(&fs::read_to_string(&path).unwrap()).unwrap());
            }
        }
    }

    fn read(&mut self, stream: TokenStream) {
        let tokens: Vec<TokenTree> = stream.into_iter().collect();
        for (n, token) in tokens.iter().enumerate() {
            let TokenTree::Group(group) = token else { continue };
            let name = |back: usize| n.checked_sub(back).map(|at| tokens[at].to_string()).unwrap_or_default();
            let found = match (name(1).as_str(), name(4).as_str()) {
                ("new", "Warning") => Some(&mut self.warned),
                ("refused" | "failed", "Error") | ("refuse", _) => Some(&mut self.refused),
                _ => None,
            };
            let words: Vec<String> = group.stream().into_iter().take(4).map(|t| t.to_string()).collect();
            if let (Some(found), [head, _, _, constant]) = (found, words.as_slice())
                && head == "findings"
            {
                found.insert(constant.to_lowercase().replace('_', "-"));
            }
            let test = name(2) == "mod" && name(1) == "tests";
            if !test {
                self.read(group.stream());
            }
        }
    }
}

#[test]
fn what_the_table_holds_is_raised_as_it_says() {
    let mut raised = Raised::default();
    raised.walk(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    for f in FINDINGS {
        let (warned, refused) = (raised.warned.contains(f.code), raised.refused.contains(f.code));
        let told = match f.told {
            Told::Warned => warned && !refused,
            // What the settings let through is warned of by its refusal's own words.
            Told::Refused => refused && !warned,
            Told::RefusedOrWarned => warned && refused,
        };
        assert!(told, "{}: {:?}, but warned of: {warned}, refused: {refused}", f.code, f.told);
    }
    let codes: BTreeSet<&str> = FINDINGS.iter().map(|f| f.code).collect();
    assert_eq!(codes.len(), FINDINGS.len(), "each code stands once");
}

/// The page, from the table.
fn page() -> String {
    let mut page = String::from(
        "# Refusals and warnings\n\n\
         Codes stand in brackets behind a refusal, and in `report.json`. A warning marked \"review\" gives the\n\
         run that verdict. `src/base/findings` makes this page.\n\n\
         Exit codes: 0 done, 1 defect of aventail, 2 usage, 3 unreadable file, 4 unsuitable input,\n\
         5 unwritable output, 6 registration failed.\n\n\
         | code | told | reason | remedy |\n|---|---|---|---|\n",
    );
    let mut all = FINDINGS.to_vec();
    all.sort_unstable_by_key(|f| f.code);
    for f in all {
        let told = match f.told {
            Told::Warned if f.doubted => "review",
            Told::Warned => "warning",
            Told::RefusedOrWarned if f.doubted => "refusal or review",
            Told::Refused => "refusal",
            Told::RefusedOrWarned => "refusal or warning",
        };
        writeln!(page, "| `{}` | {told} | {} | {} |", f.code, f.reason, f.remedy).unwrap();
    }
    page
}

#[test]
fn the_page_is_the_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/refusals.md");
    if std::env::var_os("AVENTAIL_WRITE_DOCS").is_some() {
        fs::write(&path, page()).unwrap();
    }
    let written = fs::read_to_string(&path).unwrap_or_default();
    assert!(written == page(), "docs/refusals.md is not what the table says; write it anew as this file's head tells");
}

/// String literals of the sources with blanks inside a sentence: a line that was broken without a backslash.
fn holes(stream: TokenStream, found: &mut Vec<String>) {
    for token in stream {
        match token {
            TokenTree::Group(group) => holes(group.stream(), found),
            TokenTree::Literal(literal) => {
                let text = literal.to_string();
                let mut pieces = text.split("  ");
                let mut before = pieces.next().unwrap_or_default();
                for piece in pieces {
                    let word = piece.trim_start_matches(' ').starts_with(|c: char| c.is_ascii_lowercase());
                    if before.ends_with([',', ';']) && word {
                        found.push(text.clone());
                    }
                    // Of a long run of blanks the words before it count.
                    before = if piece.is_empty() { before } else { piece };
                }
            }
            TokenTree::Ident(_) | TokenTree::Punct(_) => {}
        }
    }
}

fn sources(folder: &Path, files: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn sentences_have_no_holes() {
    let of = |text: &str| {
        let mut found = Vec::new();
        holes(TokenStream::from_str(text).unwrap(), &mut found);
        found.len()
    };
    assert_eq!(of(r#"f("other bones,              or they")"#), 1);
    assert_eq!(of("f(\"other bones, \\\n      or they; a  b, c\")"), 0);
    let (mut files, mut found) = (Vec::new(), Vec::new());
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut files);
    for path in files {
        holes(TokenStream::from_str(&fs::read_to_string(&path).unwrap()).unwrap(), &mut found);
    }
    assert!(found.is_empty(), "{found:#?}");
}
