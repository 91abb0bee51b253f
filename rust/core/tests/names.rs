//! Checks the names of types, functions, modules and constants for words that are not terms of robotics or of Rust.
//!
//! Reads the sources of the core, with its tests and examples, and of the binding. Test functions are exempt: their
//! names are sentences.

use std::fs;
use std::path::{Path, PathBuf};

/// Words that no name may contain.
const BANNED: [&str; 18] = [
    "wish", "aim", "seen", "given", "kept", "met", "most", "nothing", "beyond", "owed", "rota", "belief", "roster",
    "keeper", "desk", "truth", "merits", "mishaps",
];

/// Words that are not allowed as a complete name; as part of a name they may have another meaning (`half_way`).
const BANNED_ALONE: [&str; 3] = ["way", "own", "tap"];

const KEYWORDS: [&str; 9] = ["struct", "enum", "union", "trait", "type", "fn", "mod", "const", "static"];

fn source_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(source_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files
}

/// Splits `CamelCase` and `snake_case` into words.
fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut before = '_';
    for c in name.chars() {
        if c != '_' && (before == '_' || (c.is_uppercase() && !before.is_uppercase())) {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut().filter(|_| c != '_') {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    words
}

/// Returns the line without comment and string literals.
fn code(line: &str) -> String {
    line.split("//").next().unwrap_or("").split('"').step_by(2).collect::<Vec<_>>().join(" ")
}

/// Returns the names that a source defines, except those of tests.
fn defined(source: &str) -> Vec<String> {
    let (mut names, mut is_test) = (Vec::new(), false);
    for line in source.lines().map(code) {
        let mut tokens = line.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|token| !token.is_empty());
        is_test |= line.trim() == "#[test]";
        while let Some(token) = tokens.next() {
            if !KEYWORDS.contains(&token) {
                continue;
            }
            // In `const fn name` and `const N: usize`, the name follows the last keyword.
            let Some(name) = tokens.find(|token| !KEYWORDS.contains(token) && *token != "unsafe") else { break };
            if !std::mem::take(&mut is_test) {
                names.push(name.to_string());
            }
        }
    }
    names
}

fn is_banned(name: &str) -> bool {
    words(name).iter().any(|word| BANNED.contains(&word.as_str()))
        || BANNED_ALONE.contains(&name.to_lowercase().as_str())
}

#[test]
fn names_are_terms_of_the_field() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut found = Vec::new();
    for folder in ["core/src", "core/tests", "core/examples", "py/src"] {
        for file in source_files(&root.join(folder)) {
            let names = defined(&fs::read_to_string(&file).unwrap());
            found.extend(
                names.into_iter().filter(|name| is_banned(name)).map(|name| format!("{}: {name}", file.display())),
            );
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn banned_words_are_detected_in_every_definition() {
    for source in [
        "pub(crate) struct Wish<W> {",
        "enum KeptRow {",
        "    pub(super) fn most_stiff(&self) -> f64 {",
        "const MOST_STEPS: usize = 3;",
        "mod seen;",
        "pub(crate) const fn given() {}",
        "type Given = u32;",
        "    fn way(&self) {}",
    ] {
        assert!(defined(source).iter().any(|name| is_banned(name)), "{source}");
    }
    for source in
        ["fn foremost() {}", "fn half_way() {}", "// struct Wish", "#[test]\nfn nothing_is_lost() {}", "let given = 1;"]
    {
        assert!(!defined(source).iter().any(|name| is_banned(name)), "{source}");
    }
}
