//! Findings: every code that the sources raise is in the table, the table holds no others, and `docs/refusals.md` is made
//! from it. After a change of the table, write the page anew: `AVENTAIL_WRITE_DOCS=1 cargo test --release --test findings`.

#![expect(clippy::unwrap_used, reason = "a test that cannot read the sources fails")]

use aventail::findings::{FINDINGS, Told};
use proc_macro2::{TokenStream, TokenTree};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::str::FromStr;

/// Codes that a file raises outside its tests.
fn raised(stream: TokenStream, found: &mut BTreeSet<String>) {
    let tokens: Vec<TokenTree> = stream.into_iter().collect();
    for (n, token) in tokens.iter().enumerate() {
        let TokenTree::Group(group) = token else { continue };
        let name = |back: usize| n.checked_sub(back).map(|at| tokens[at].to_string()).unwrap_or_default();
        let warning = name(1) == "new" && name(4) == "Warning";
        if warning || ((name(1) == "refused" || name(1) == "failed") && name(4) == "Error") {
            let first = group.stream().into_iter().next().map(|t| t.to_string()).unwrap_or_default();
            if let Some(code) = first.strip_prefix('"').and_then(|c| c.strip_suffix('"')) {
                found.insert(code.to_owned());
            }
        }
        let test = name(2) == "mod" && name(1) == "tests";
        if !test {
            raised(group.stream(), found);
        }
    }
}

fn walk(folder: &Path, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("tests") {
            walk(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests.rs") {
            raised(TokenStream::from_str(&fs::read_to_string(&path).unwrap()).unwrap(), found);
        }
    }
}

#[test]
fn what_is_raised_is_in_the_table_and_nothing_else() {
    let mut found = BTreeSet::new();
    walk(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
    found.retain(|code| !code.is_empty());
    let table: BTreeSet<String> = FINDINGS.iter().map(|f| f.code.to_owned()).collect();
    assert_eq!(found.difference(&table).collect::<Vec<_>>(), Vec::<&String>::new(), "raised, not in the table");
    assert_eq!(table.difference(&found).collect::<Vec<_>>(), Vec::<&String>::new(), "in the table, never raised");
    assert!(FINDINGS.is_sorted_by_key(|f| f.code), "the table is sorted by code");
}

/// The page, from the table.
fn page() -> String {
    let mut page = String::from(
        "# Refusals and warnings\n\n\
         What aventail refuses or warns of, by code. Codes stand in square brackets behind a refusal and in\n\
         `report.json` beside a warning. This page is made from the program's own table\n\
         (`src/base/findings.rs`).\n\n\
         Exit codes: 0 done, 1 defect of aventail, 2 usage, 3 unreadable file, 4 unsuitable input,\n\
         5 unwritable output, 6 registration failed.\n\n\
         | code | told | reason | remedy |\n|---|---|---|---|\n",
    );
    for f in FINDINGS {
        let told = match f.told {
            Told::Warned => "warning",
            Told::Refused => "refusal",
            Told::RefusedOrWarned => "refusal, or warning where doubtful",
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
