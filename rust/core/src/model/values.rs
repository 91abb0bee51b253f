//! Attributes as numbers and names: complete, finite and short, otherwise an error that shows them.

use std::fmt::Write as _;

use roxmltree::Node;

use super::text::{Source, shortened, xacro};
use crate::error::Result;

/// Longest name [bytes].
const MAX_NAME: usize = 256;

impl Source<'_> {
    /// Limits the length of names, which appear in messages.
    pub(super) fn refuse_long(&self, node: Option<Node>, attribute: &str) -> Result<()> {
        let Some((node, name)) = node.and_then(|node| Some((node, node.attribute(attribute)?))) else { return Ok(()) };
        if name.len() > MAX_NAME {
            let message = format!("the name '{}' has {} bytes; at most {MAX_NAME}", shortened(name, 40), name.len());
            return Err(self.error_at(node, message));
        }
        Ok(())
    }

    pub(super) fn named(&self, node: Node, what: &str) -> Result<String> {
        self.refuse_long(Some(node), "name")?;
        match node.attribute("name") {
            Some(name) if is_xacro(name) => Err(self.error_at(node, xacro(&format!("the name '{name}'")))),
            Some(name) if !name.trim().is_empty() => Ok(name.to_owned()),
            _ => Err(self.error_at(node, format!("a {what} without a name; give it name=\"...\""))),
        }
    }

    pub(super) fn required(&self, node: Node, attribute: &str, owner: &str) -> Result<f64> {
        self.number(node, attribute, owner)?.ok_or_else(|| {
            self.error_at(node, format!("{owner}: <{}> without {attribute}=\"...\"", node.tag_name().name()))
        })
    }

    pub(super) fn number(&self, node: Node, attribute: &str, owner: &str) -> Result<Option<f64>> {
        Ok(self.vector::<1>(node, attribute, owner)?.map(|[value]| value))
    }

    pub(super) fn number_or_infinite(&self, node: Node, attribute: &str, owner: &str) -> Result<Option<f64>> {
        match node.attribute(attribute).and_then(|value| value.trim().parse::<f64>().ok()) {
            Some(value) if value.is_infinite() => Ok(Some(value)),
            _ => self.number(node, attribute, owner),
        }
    }

    /// Reads exactly `N` finite numbers, or returns an error that shows them.
    pub(super) fn vector<const N: usize>(&self, node: Node, attribute: &str, owner: &str) -> Result<Option<[f64; N]>> {
        let Some(value) = node.attribute(attribute) else { return Ok(None) };
        let mut numbers = [0.0; N];
        let mut count = 0;
        let mut fault = None;
        for token in value.split_whitespace() {
            match token.parse::<f64>() {
                Ok(number) if number.is_finite() => {
                    if let Some(slot) = numbers.get_mut(count) {
                        *slot = number;
                    }
                }
                _ => fault = fault.or(Some(token)),
            }
            count += 1;
        }
        if fault.is_none() && count == N {
            return Ok(Some(numbers));
        }
        let mut message =
            format!("{owner}: {attribute} of <{}> is \"{}\"; ", node.tag_name().name(), shortened(value, 40));
        if is_xacro(value) {
            message.push_str(&xacro("the expression"));
        } else {
            if let Some(token) = fault {
                let _ = write!(message, "'{}' is not a finite number; ", shortened(token, 40));
            }
            let plural = if N == 1 { "" } else { "s" };
            let _ = write!(
                message,
                "expected {N} finite number{plural}, got {count} word{}",
                if count == 1 { "" } else { "s" }
            );
        }
        Err(self.error_at(node, message))
    }
}

fn is_xacro(value: &str) -> bool {
    value.contains("${") || value.contains("$(")
}
