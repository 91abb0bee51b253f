//! Copies the docstrings of the stub `python/pliant/_core.pyi` into the compiled module, so that they are written once.
//!
//! Writes `stub.rs` into `OUT_DIR`: the macro `stub!` returns the docstring of a class, a member or a function.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::path::Path;

const STUB: &str = "../../python/pliant/_core.pyi";
const QUOTES: &str = "\"\"\"";
/// Classes and functions that only the Python package uses: their docstrings stay in the stub, which saves 25 kB.
const INTERNAL: &[&str] = &[
    "ArmCycle",
    "ArmPoints",
    "BusCycle",
    "BusStatus",
    "CommandLimiter",
    "ExclusiveAccess",
    "HandGuidingLaw",
    "PortState",
    "PositionFilter",
    "SerialPort",
    "ServoCodec",
    "ServoGroup",
    "ThermalModel",
    "torque_margin",
    "update_contacts",
];

/// Docstrings by name, e.g. `Model`, `Model.gravity`, `compliance`. Those of overloads are joined. An attribute without
/// docstring has the text of the class argument or attribute with its name.
type Docs = BTreeMap<String, String>;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={STUB}");
    println!("cargo::rerun-if-changed=build.rs");
    let docs = read(&std::fs::read_to_string(STUB)?)?;
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("stub.rs"), macro_source(&docs)?)?;
    Ok(())
}

/// Reads the docstrings of a stub formatted by `ruff format`: indented by four spaces, each signature ends a line.
fn read(stub: &str) -> Result<Docs, String> {
    let (mut docs, mut class, mut name) = (Docs::new(), String::new(), String::new());
    let mut lines = stub.lines().skip_while(|line| !line.starts_with("from ")).enumerate();
    while let Some((number, line)) = lines.next() {
        let text = line.trim_start();
        let indent = line.len() - text.len();
        if indent == 0 && !text.is_empty() && !text.starts_with([')', '@']) {
            class.clear();
        }
        if let Some(of) = text.strip_prefix("class ") {
            class = word(of);
            name.clone_from(&class);
        } else if let Some(of) = text.strip_prefix("def ") {
            name = if class.is_empty() { word(of) } else { format!("{class}.{}", word(of)) };
            docs.entry(name.clone()).or_default();
        } else if indent == 4 && !class.is_empty() && text.split_once(": ").is_some_and(|(of, _)| of == word(of)) {
            docs.entry(format!("{class}.{}", word(text))).or_default();
        } else if let Some(first) = text.strip_prefix(QUOTES) {
            let mut doc = first.to_owned();
            while !doc.ends_with(QUOTES) {
                let (_, more) = lines.next().ok_or_else(|| format!("line {number}: the docstring never ends"))?;
                doc = format!("{doc}\n{}", more.get(indent..).unwrap_or_default());
            }
            let doc = doc.trim_end_matches(QUOTES).trim_end();
            if doc.contains('\\') {
                return Err(format!("docstring of {name}: escapes are not understood here"));
            }
            let all = docs.entry(name.clone()).or_default();
            *all = if all.is_empty() { doc.to_owned() } else { format!("{all}\n\n{doc}") };
        }
    }
    for (name, doc) in &docs.clone() {
        if let Some((class, member)) = name.split_once('.').filter(|_| doc.is_empty()) {
            let of_class = docs.get(class).map_or_else(String::new, |doc| argument(doc, member));
            docs.insert(name.clone(), of_class);
        }
    }
    docs.retain(|name, doc| !name.starts_with('_') && !doc.is_empty());
    docs.iter_mut().filter(|(name, _)| INTERNAL.contains(&word(name).as_str())).for_each(|(_, doc)| doc.clear());
    Ok(docs)
}

/// Returns the text about the argument or attribute `name` in the docstring of a class.
fn argument(doc: &str, name: &str) -> String {
    let entry = format!("    {name}: ");
    let is_heading = |line: &&str| *line == "Args:" || *line == "Attributes:";
    let lines = doc.lines().skip_while(|line| !is_heading(line)).skip_while(|line| !line.starts_with(&entry));
    let entry_lines = lines.enumerate().take_while(|(i, line)| *i == 0 || line.starts_with("        "));
    let text = entry_lines.map(|(_, line)| line.trim()).collect::<Vec<_>>().join("\n");
    text.strip_prefix(&format!("{name}: ")).unwrap_or_default().to_owned()
}

fn word(text: &str) -> String {
    text.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
}

/// Returns the source of the macro `stub!`.
fn macro_source(docs: &Docs) -> Result<String, std::fmt::Error> {
    let mut out = String::from("macro_rules! stub {\n");
    for (name, doc) in docs {
        writeln!(out, "({name}) => {{ {doc:?} }};")?;
    }
    out.push_str("}\n");
    Ok(out)
}
