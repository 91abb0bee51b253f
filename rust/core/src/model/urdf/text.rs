//! XML of a URDF text: checks of size, depth, entities and root element; line and column of an offset.

use std::cell::Cell;

use roxmltree::{Document, Node, ParsingOptions};

use crate::error::{Error, Position, Result};

/// Largest size of a text [bytes]. Real robots stay below 1 MB.
pub(in crate::model) const MAX_BYTES: usize = 16 << 20;

/// Maximum nesting depth. Real robots stay below 10. urdf-rs recurses: thousands of levels would overflow the stack,
/// which aborts the process.
const MAX_DEPTH: usize = 64;

/// Maximum number of attributes of one element. Real robots stay below 30. The XML parser compares every pair of
/// attributes, so its time grows with the square of their number.
const MAX_ATTRIBUTES: usize = 64;

/// Maximum number of XML nodes: bounds the time for a hostile text to about a second.
const MAX_NODES: u32 = 2_000_000;
/// Maximum number of links and of joints: bounds the time for a hostile text to about a second.
pub(super) const MAX_LINKS: usize = 10_000;

/// A URDF text with its name, for messages with line and column.
#[derive(Debug)]
pub(in crate::model) struct Source<'a> {
    /// Name of the file, or `<string>`.
    name: &'a str,
    text: &'a str,
    /// Byte offset at which each line starts.
    line_starts: Vec<usize>,
    /// Cache: last offset requested, the start of its line, and its column. Counting of columns continues from it,
    /// which keeps files of one very long line fast.
    last: Cell<(usize, usize, usize)>,
}

impl<'a> Source<'a> {
    pub(in crate::model) fn new(name: &'a str, text: &'a str) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { name, text, line_starts, last: Cell::new((0, 0, 1)) }
    }

    pub(in crate::model) const fn name(&self) -> &'a str {
        self.name
    }

    /// Returns line and column, from 1, of a byte offset; the column counts characters.
    pub(in crate::model) fn at(&self, offset: usize) -> Position {
        let line = self.line_starts.partition_point(|&start| start <= offset);
        let start = self.line_starts.get(line.wrapping_sub(1)).copied().unwrap_or(0);
        let (last, last_start, last_column) = self.last.get();
        let (from, counted) = if last_start == start && last <= offset { (last, last_column) } else { (start, 1) };
        let column = counted + self.text.get(from..offset).map_or(0, |part| part.chars().count());
        self.last.set((offset, start, column));
        match (u32::try_from(line), u32::try_from(column)) {
            (Ok(line), Ok(column)) => Position(Some((line, column))),
            _ => Position(None),
        }
    }

    pub(in crate::model) fn error(&self, at: Position, message: impl Into<String>) -> Error {
        Error::Urdf { source_name: self.name.to_owned(), at, message: message.into() }
    }

    /// Creates an error at the position of an element.
    pub(in crate::model) fn error_at(&self, node: Node, message: impl Into<String>) -> Error {
        self.error(self.at(node.range().start), message)
    }

    /// Parses the text. Refuses texts that are too large or too deep, unexpanded xacro, and a root element other than
    /// `<robot>`.
    pub(in crate::model) fn parse(&self) -> Result<Document<'a>> {
        if self.text.len() > MAX_BYTES {
            let message = format!("{} bytes of text, at most {MAX_BYTES}", self.text.len());
            return Err(self.error(Position(None), message));
        }
        if self.text.trim().is_empty() {
            return Err(self.error(Position(None), "the text is empty; a URDF starts with <robot name=\"...\">"));
        }
        self.refuse_wide()?;
        let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
        let document = Document::parse_with_options(self.text, options).map_err(|error| self.malformed(&error))?;
        self.refuse_deep(&document)?;
        self.refuse_foreign(&document)?;
        Ok(document)
    }

    fn malformed(&self, error: &roxmltree::Error) -> Error {
        let at = Position(Some((error.pos().row, error.pos().col)));
        match error {
            roxmltree::Error::DtdDetected => {
                let at = self.text.find("<!DOCTYPE").map_or(Position(None), |offset| self.at(offset));
                self.error(at, "a DOCTYPE is refused, because its entities can grow without bound; remove it")
            }
            roxmltree::Error::UnknownEntityReference(name, _) => self.error(
                at,
                format!(
                    "unknown entity '&{};'; only &amp; &lt; &gt; &quot; &apos; exist in a URDF",
                    shortened(name, 40)
                ),
            ),
            roxmltree::Error::UnknownNamespace(prefix, _) if prefix == "xacro" => {
                self.error(at, xacro("an xacro element"))
            }
            roxmltree::Error::NodesLimitReached => {
                self.error(Position(None), format!("more than {MAX_NODES} XML nodes; a robot has some thousands"))
            }
            roxmltree::Error::UnclosedRootNode | roxmltree::Error::UnexpectedEndOfStream => {
                self.error(Position(None), "the text ends too early; </robot> is missing")
            }
            other if !self.text.trim_start().starts_with('<') => self.error(
                at,
                format!(
                    "not XML: {}; for a file use from_urdf, this reads its text",
                    shortened(&other.to_string(), 300)
                ),
            ),
            other => self.error(at, format!("not well-formed XML: {}", shortened(&other.to_string(), 300))),
        }
    }

    /// Returns an error for an element with too many attributes, counted by the `="` and `='` from one `<` to the next:
    /// an upper bound on their number.
    fn refuse_wide(&self) -> Result<()> {
        let (mut tag, mut attributes, mut equals) = (0, 0, false);
        for (offset, byte) in self.text.bytes().enumerate() {
            match byte {
                b'<' => (tag, attributes, equals) = (offset, 0, false),
                b'=' => equals = true,
                b' ' | b'\t' | b'\r' | b'\n' => {}
                b'"' | b'\'' if equals => {
                    (attributes, equals) = (attributes + 1, false);
                    if attributes > MAX_ATTRIBUTES {
                        let message = format!("an element with more than {MAX_ATTRIBUTES} attributes");
                        return Err(self.error(self.at(tag), message));
                    }
                }
                _ => equals = false,
            }
        }
        Ok(())
    }

    fn refuse_deep(&self, document: &Document) -> Result<()> {
        // Document order makes this fast: all nodes before the first one that is too deep have few ancestors.
        let is_deep = |node: &Node| node.is_element() && node.ancestors().nth(MAX_DEPTH + 1).is_some();
        match document.descendants().find(is_deep) {
            Some(node) => Err(self.error_at(node, format!("elements nested deeper than {MAX_DEPTH} levels"))),
            None => Ok(()),
        }
    }

    fn refuse_foreign(&self, document: &Document) -> Result<()> {
        let root = document.root_element();
        let is_xacro = |node: &Node| node.tag_name().namespace().is_some_and(|uri| uri.contains("xacro"));
        if let Some(node) = document.descendants().find(|node| node.is_element() && is_xacro(node)) {
            return Err(
                self.error_at(node, xacro(&format!("the element <xacro:{}>", shortened(node.tag_name().name(), 40))))
            );
        }
        let name = root.tag_name().name();
        let hint = match name {
            "robot" => return Ok(()),
            "mujoco" | "mujocoinclude" => "this is an MJCF model of MuJoCo; export or find the robot's URDF",
            "sdf" | "gazebo" | "world" | "model" => "this looks like SDF (Gazebo); export or find the robot's URDF",
            "COLLADA" => "this is a mesh; give the URDF that refers to it",
            "html" | "HTML" => "this is a web page; download the raw file",
            _ => "give a URDF",
        };
        Err(self.error_at(root, format!("the root element is <{}>, not <robot>: {hint}", shortened(name, 40))))
    }
}

/// Returns the message for an unexpanded xacro file, with the command that expands it.
pub(super) fn xacro(what: &str) -> String {
    format!("{what} shows that xacro was not run; expand the file first: xacro robot.urdf.xacro > robot.urdf")
}

/// Returns true if a value contains an expression that xacro would replace.
pub(super) fn is_xacro(value: &str) -> bool {
    value.contains("${") || value.contains("$(")
}

/// Returns a text, truncated to `most` characters so that a message stays readable.
pub(super) fn shortened(value: &str, most: usize) -> String {
    if value.chars().count() <= most { value.to_owned() } else { value.chars().take(most).chain(['…']).collect() }
}
