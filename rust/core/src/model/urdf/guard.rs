//! Checks of every link and joint, and the reduced text that urdf-rs parses.
//!
//! urdf-rs reads an absent value as 0, drops words that are not numbers, accepts NaN, and refuses a robot for an error
//! in a visual. It is therefore given only links, joints and inertials with complete attributes, see [`JOINT`] and
//! [`INERTIAL`].

use std::collections::HashMap;
use std::fmt::Write as _;

use roxmltree::{Document, Node};

use super::text::{MAX_LINKS, Source, is_xacro, shortened, xacro};
use crate::error::{Position, Result};

const JOINT_TYPES: [&str; 7] = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"];

/// Maximum length of a name [bytes].
const MAX_NAME: usize = 256;

/// Kind of value that an attribute must have.
#[derive(Clone, Copy)]
enum Form {
    Name,
    /// The given count of finite numbers, separated by spaces.
    Numbers(usize),
    /// One finite number or an infinity.
    Bound,
}

/// An attribute that is passed on to urdf-rs.
struct Attribute {
    name: &'static str,
    form: Form,
    /// Text that is written for an absent attribute; `None` if the attribute is required.
    absent: Option<&'static str>,
}

/// A child element that is passed on to urdf-rs.
struct Part {
    name: &'static str,
    attributes: &'static [Attribute],
    /// Message if the element is absent; `None` if it is optional.
    missing: Option<&'static str>,
}

const fn required(name: &'static str, form: Form) -> Attribute {
    Attribute { name, form, absent: None }
}

const fn optional(name: &'static str, form: Form, absent: &'static str) -> Attribute {
    Attribute { name, form, absent: Some(absent) }
}

const fn part(name: &'static str, attributes: &'static [Attribute]) -> Part {
    Part { name, attributes, missing: None }
}

/// Pose of a joint or inertial. The reduced text has no URDF version, so urdf-rs ignores the quaternion; the reader
/// takes it from the original text.
const ORIGIN: Part = part(
    "origin",
    &[
        optional("xyz", Form::Numbers(3), "0 0 0"),
        optional("rpy", Form::Numbers(3), "0 0 0"),
        optional("quat_xyzw", Form::Numbers(4), "0 0 0 1"),
    ],
);

/// Child elements of a joint. Absent limits are written as infinite, absent damping and friction as NaN.
const JOINT: [Part; 7] = [
    ORIGIN,
    Part { missing: Some("<parent link=\"...\"/> is missing"), ..part("parent", &[required("link", Form::Name)]) },
    Part { missing: Some("<child link=\"...\"/> is missing"), ..part("child", &[required("link", Form::Name)]) },
    part("axis", &[required("xyz", Form::Numbers(3))]),
    part(
        "limit",
        &[
            optional("lower", Form::Bound, "-inf"),
            optional("upper", Form::Bound, "inf"),
            optional("effort", Form::Bound, "inf"),
            optional("velocity", Form::Bound, "inf"),
        ],
    ),
    part(
        "mimic",
        &[
            required("joint", Form::Name),
            optional("multiplier", Form::Numbers(1), "1"),
            optional("offset", Form::Numbers(1), "0"),
        ],
    ),
    part("dynamics", &[optional("damping", Form::Numbers(1), "nan"), optional("friction", Form::Numbers(1), "nan")]),
];

/// Child elements of an inertial.
const INERTIAL: [Part; 3] = [
    ORIGIN,
    Part {
        missing: Some("<inertial> without <mass value=\"...\"/>"),
        ..part("mass", &[required("value", Form::Numbers(1))])
    },
    Part {
        missing: Some(
            "<inertial> without <inertia ixx=... ixy=... ixz=... iyy=... iyz=... izz=.../>; leave <inertial> out for a \
             massless link",
        ),
        ..part(
            "inertia",
            &[
                required("ixx", Form::Numbers(1)),
                required("ixy", Form::Numbers(1)),
                required("ixz", Form::Numbers(1)),
                required("iyy", Form::Numbers(1)),
                required("iyz", Form::Numbers(1)),
                required("izz", Form::Numbers(1)),
            ],
        )
    },
];

/// Links and joints that passed the checks, and the reduced text for urdf-rs.
pub(in crate::model) struct Checked<'n, 'i> {
    /// Elements of the links, for the positions of later errors.
    pub(in crate::model) links: Vec<Node<'n, 'i>>,
    /// Elements of the joints, for the positions of later errors.
    pub(in crate::model) joints: Vec<Node<'n, 'i>>,
    /// URDF text with the checked elements only.
    pub(super) text: String,
}

/// Checks all links and joints of a document and writes the reduced text.
pub(in crate::model) fn check<'n, 'i>(source: &Source, document: &'n Document<'i>) -> Result<Checked<'n, 'i>> {
    let root = document.root_element();
    let mut text = format!("<robot name=\"{}\">", escaped(root.attribute("name").unwrap_or_default()));
    let (mut links, mut joints) = (Vec::new(), Vec::new());
    for node in root.children() {
        let (what, nodes) = match () {
            () if is(node, "link") => ("link", &mut links),
            () if is(node, "joint") => ("joint", &mut joints),
            () => continue,
        };
        if nodes.len() == MAX_LINKS {
            return Err(source.error_at(node, format!("more than {MAX_LINKS} {what}s")));
        }
        nodes.push(node);
        source.element(node, what, &mut text)?;
    }
    text.push_str("</robot>");
    unique(source, "link", &links)?;
    unique(source, "joint", &joints)?;
    if links.is_empty() {
        return Err(source.error_at(root, "the robot has no links"));
    }
    Ok(Checked { links, joints, text })
}

/// Returns the first child element of this name, in the parent's namespace.
pub(super) fn child<'n, 'i>(parent: Node<'n, 'i>, name: &str) -> Option<Node<'n, 'i>> {
    parent.children().find(|node| is(*node, name))
}

fn is(node: Node, name: &str) -> bool {
    let space = node.parent_element().and_then(|parent| parent.tag_name().namespace());
    node.is_element() && node.tag_name().name() == name && node.tag_name().namespace() == space
}

fn unique(source: &Source, what: &str, nodes: &[Node]) -> Result<()> {
    let mut seen: HashMap<&str, Node> = HashMap::new();
    for node in nodes {
        let name = node.attribute("name").unwrap_or_default();
        if let Some(first) = seen.insert(name, *node) {
            let Position(at) = source.at(first.range().start);
            let line = at.map_or(String::new(), |(line, _)| format!(", first in line {line}"));
            let message = format!("two {what}s are named '{name}'{line}; names must be unique");
            return Err(source.error_at(*node, message));
        }
    }
    Ok(())
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

impl Source<'_> {
    /// Checks a link or joint and appends it to the reduced text.
    fn element(&self, node: Node, what: &str, text: &mut String) -> Result<()> {
        let name = match self.name_of(node, "name")? {
            Some(name) if is_xacro(name) => return Err(self.error_at(node, xacro(&format!("the name '{name}'")))),
            Some(name) if !name.trim().is_empty() => name,
            _ => return Err(self.error_at(node, format!("a {what} without a name; give it name=\"...\""))),
        };
        let owner = format!("{what} '{name}'");
        let _ = write!(text, "<{what} name=\"{}\"", escaped(name));
        if what == "joint" {
            let kind = node.attribute("type").unwrap_or_default();
            if !JOINT_TYPES.contains(&kind) {
                let (kind, known) = (shortened(kind, 40), JOINT_TYPES.join(", "));
                return Err(self.error_at(node, format!("{owner}: type is '{kind}'; it must be one of {known}")));
            }
            let _ = write!(text, " type=\"{kind}\">");
            self.parts(node, &JOINT, &owner, text)?;
        } else {
            text.push('>');
            if let Some(inertial) = self.only_child(node, "inertial", &owner)? {
                text.push_str("<inertial>");
                self.parts(inertial, &INERTIAL, &owner, text)?;
                text.push_str("</inertial>");
            }
        }
        let _ = write!(text, "</{what}>");
        Ok(())
    }

    fn parts(&self, parent: Node, parts: &[Part], owner: &str, text: &mut String) -> Result<()> {
        for part in parts {
            let node = self.only_child(parent, part.name, owner)?;
            match (node, part.missing) {
                (None, Some(missing)) => return Err(self.error_at(parent, format!("{owner}: {missing}"))),
                // Leave out an absent optional element if one of its attributes has no default.
                (None, None) if part.attributes.iter().any(|attribute| attribute.absent.is_none()) => continue,
                _ => {}
            }
            let _ = write!(text, "<{}", part.name);
            for attribute in part.attributes {
                let value = match node {
                    Some(node) => self.value(node, attribute, owner)?,
                    None => None,
                };
                let Some(value) = value.or(attribute.absent) else {
                    let message = format!("{owner}: <{}> without {}=\"...\"", part.name, attribute.name);
                    return Err(self.error_at(node.unwrap_or(parent), message));
                };
                let _ = write!(text, " {}=\"{}\"", attribute.name, escaped(value));
            }
            text.push_str("/>");
        }
        Ok(())
    }

    /// Returns the child element of this name; `None` if absent, an error if there is a second one.
    fn only_child<'n, 'i>(&self, parent: Node<'n, 'i>, name: &str, owner: &str) -> Result<Option<Node<'n, 'i>>> {
        let mut found = parent.children().filter(|node| is(*node, name));
        let first = found.next();
        match found.next() {
            Some(second) => Err(self.error_at(second, format!("{owner}: a second <{name}>; at most one is allowed"))),
            None => Ok(first),
        }
    }

    /// Returns the text of an attribute after checking it; `None` if absent.
    fn value<'n>(&self, node: Node<'n, '_>, attribute: &Attribute, owner: &str) -> Result<Option<&'n str>> {
        let value = node.attribute(attribute.name);
        match attribute.form {
            Form::Name => return Ok(self.name_of(node, attribute.name)?.filter(|name| !name.is_empty())),
            Form::Bound if value.is_some_and(|v| v.trim().parse().is_ok_and(f64::is_infinite)) => {}
            Form::Bound => self.finite_numbers(node, attribute.name, owner, 1)?,
            Form::Numbers(count) => self.finite_numbers(node, attribute.name, owner, count)?,
        }
        Ok(value)
    }

    /// Returns the name in an attribute; an error if it is too long for a message.
    fn name_of<'n>(&self, node: Node<'n, '_>, attribute: &str) -> Result<Option<&'n str>> {
        let name = node.attribute(attribute);
        if let Some(name) = name.filter(|name| name.len() > MAX_NAME) {
            let message = format!("the name '{}' has {} bytes; at most {MAX_NAME}", shortened(name, 40), name.len());
            return Err(self.error_at(node, message));
        }
        Ok(name)
    }

    /// Returns an error unless the attribute has exactly `expected` finite numbers or is absent.
    fn finite_numbers(&self, node: Node, attribute: &str, owner: &str, expected: usize) -> Result<()> {
        let Some(value) = node.attribute(attribute) else { return Ok(()) };
        let count = value.split_whitespace().count();
        let fault = value.split_whitespace().find(|word| !word.parse().is_ok_and(f64::is_finite));
        if fault.is_none() && count == expected {
            return Ok(());
        }
        let mut message =
            format!("{owner}: {attribute} of <{}> is \"{}\"; ", node.tag_name().name(), shortened(value, 40));
        if is_xacro(value) {
            message.push_str(&xacro("the expression"));
        } else {
            if let Some(word) = fault {
                let _ = write!(message, "'{}' is not a finite number; ", shortened(word, 40));
            }
            let [numbers, words] = [expected, count].map(|n| if n == 1 { "" } else { "s" });
            let _ = write!(message, "expected {expected} finite number{numbers}, got {count} word{words}");
        }
        Err(self.error_at(node, message))
    }
}
