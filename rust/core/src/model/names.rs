//! Lists of names for messages: shortened, most similar name first.

use std::fmt::Write as _;

/// Maximum number of names in a message.
pub(super) const SHOWN: usize = 40;

/// Joins names with commas, shortened.
pub(super) fn some<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    let rest = names.len().saturating_sub(SHOWN);
    let mut list = names.take(SHOWN).collect::<Vec<_>>().join(", ");
    if rest > 0 {
        let _ = write!(list, " and {rest} more");
    }
    list
}

/// Lists names, those similar to `wanted` first.
pub(super) fn listed<T>(things: &[T], name: impl Fn(&T) -> &String, wanted: &str) -> String {
    some(likeliest(things.iter().map(|thing| name(thing).as_str()).collect(), wanted).into_iter())
}

/// Sorts names by similarity to `wanted`.
pub(super) fn likeliest<'a>(mut names: Vec<&'a str>, wanted: &str) -> Vec<&'a str> {
    names.sort_by_key(|candidate| distance(candidate, wanted));
    names
}

/// Levenshtein distance of two names, from their first hundred characters.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().take(100).collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().take(100).enumerate() {
        let mut diagonal = i;
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let above = row[j + 1];
            row[j + 1] = (diagonal + usize::from(!x.eq_ignore_ascii_case(y))).min(above + 1).min(row[j] + 1);
            diagonal = above;
        }
    }
    row.last().copied().unwrap_or(0)
}
