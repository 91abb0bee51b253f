//! Checks the order of the crate's modules: each imports from modules before it only.
//!
//! Reads every path that begins with `crate::` in the sources, including test modules. Comments are ignored, so that
//! documentation may link to later modules.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Modules of the crate, lowest first. A folder counts as one module.
const ORDER: [&str; 15] = [
    "error",
    "math",
    "pose",
    "model",
    "kinematics",
    "params",
    "task",
    "law",
    "command",
    "batch",
    "controller",
    "analysis",
    "contact",
    "arm",
    "equations",
];

/// Modules that must not import each other in either direction.
const APART: [&str; 2] = ["analysis", "contact"];

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
    files.sort();
    files
}

/// Returns the source without comments.
fn code(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// Returns the first name after each `crate::`; for a list in braces, that of every entry.
fn imported(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if !rest.starts_with('{') {
            names.push(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
            continue;
        }
        let (mut depth, mut fresh, mut name) = (0, true, String::new());
        for c in rest.chars() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 1 && (c.is_alphanumeric() || c == '_') && fresh {
                name.push(c);
                continue;
            }
            if !name.is_empty() {
                names.push(std::mem::take(&mut name));
                fresh = false;
            }
            fresh |= depth == 1 && (c == ',' || c == '{');
            if depth == 0 {
                break;
            }
        }
    }
    names
}

/// Returns the module of a file: its first folder below `root`, or its name without extension.
fn module(file: &Path, root: &Path) -> String {
    let first = file.strip_prefix(root).unwrap().components().next().unwrap();
    Path::new(first.as_os_str()).file_stem().unwrap().to_string_lossy().into_owned()
}

/// Returns a message for every import from a later module.
fn upward(from: &str, code: &str) -> Vec<String> {
    let position_of = |name: &str| ORDER.iter().position(|module| *module == name);
    let position = position_of(from);
    let wrong = |name: &String| {
        let other = position_of(name);
        position.is_some()
            && other.is_some()
            && (other > position || (APART.contains(&from) && APART.contains(&&**name)))
            && name != from
    };
    imported(code).into_iter().filter(wrong).map(|name| format!("{from} imports {name}")).collect()
}

#[test]
fn modules_import_only_from_those_before_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut violations = Vec::new();
    for file in source_files(&root) {
        let from = module(&file, &root);
        let text = fs::read_to_string(&file).unwrap();
        violations.extend(upward(&from, &code(&text)).into_iter().map(|what| format!("{}: {what}", file.display())));
    }
    assert!(violations.is_empty(), "{}", violations.join("\n"));
}

#[test]
fn every_module_is_in_the_order() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let modules: BTreeSet<String> =
        source_files(&root).iter().map(|file| module(file, &root)).filter(|name| name != "lib").collect();
    assert_eq!(modules, ORDER.iter().map(|name| (*name).to_string()).collect());
}

/// Only constants and array types are imported from the root, so that every other import names its module.
#[test]
fn the_root_is_used_for_constants_and_array_types_only() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let allowed = ["MAX_AXES", "MAX_JOINTS", "AxisVec", "JointVec", "Rows"];
    for file in source_files(&root) {
        for name in imported(&code(&fs::read_to_string(&file).unwrap())) {
            assert!(ORDER.contains(&&*name) || allowed.contains(&&*name), "{}: crate::{name}", file.display());
        }
    }
}

/// In the file of a top-level module, `super` is the root; an import through it would not be checked.
#[test]
fn no_top_module_imports_through_super() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for file in source_files(&root) {
        let inside = file.strip_prefix(&root).unwrap();
        if inside.components().count() == 1 || (inside.components().count() == 2 && inside.ends_with("mod.rs")) {
            let text = code(&fs::read_to_string(&file).unwrap());
            let violations: Vec<_> =
                text.lines().filter(|line| line.contains("super::") && !line.contains("super::*")).collect();
            assert!(violations.is_empty(), "{}: {violations:?}", file.display());
        }
    }
}

#[test]
fn upward_imports_are_detected_in_every_form() {
    for source in [
        "use crate::controller::Controller;",
        "use crate::{MAX_AXES, controller::Controller, pose::Pose};",
        "use crate::{\n    MAX_AXES,\n    controller::{Controller, StepInput},\n};",
        "fn f() { crate::controller::f() }",
        "#[cfg(test)]\nmod tests { use crate::controller::Controller; }",
    ] {
        assert_eq!(upward("law", &code(source)), ["law imports controller"], "{source}");
        assert!(upward("contact", &code(source)).is_empty(), "{source}");
    }
    assert!(upward("law", &code("/// See [`crate::controller`].\nuse crate::{pose::Pose, task};")).is_empty());
    assert_eq!(upward("contact", "use crate::analysis::report;"), ["contact imports analysis"]);
}

#[test]
fn every_test_file_belongs_to_a_program() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = ["Cargo.toml", "tests/all.rs"].map(|file| fs::read_to_string(folder.join(file)).unwrap());
    for entry in fs::read_dir(folder.join("tests")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            let name = path.file_stem().unwrap().to_str().unwrap();
            let declared = [format!("path = \"tests/{name}.rs\""), format!("\nmod {name};")];
            assert!(
                programs.iter().zip(declared).any(|(text, line)| text.contains(&line)),
                "tests/{name}.rs is never compiled: add `mod {name};` to tests/all.rs"
            );
        }
    }
}
