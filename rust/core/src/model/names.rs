//! Lists of names for messages: limited in length, most similar name first.

use std::fmt::Write as _;

/// Maximum number of names in a message.
pub(super) const SHOWN: usize = 40;

/// Joins at most [`SHOWN`] names with commas, followed by the number of omitted names.
pub(super) fn some<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    let rest = names.len().saturating_sub(SHOWN);
    let mut list = names.take(SHOWN).collect::<Vec<_>>().join(", ");
    if rest > 0 {
        let _ = write!(list, " and {rest} more");
    }
    list
}

/// Returns the names of `things` for a message, those most similar to `wanted` first.
pub(super) fn listed<T>(things: &[T], name: impl Fn(&T) -> &String, wanted: &str) -> String {
    some(likeliest(things.iter().map(|thing| name(thing).as_str()).collect(), wanted).into_iter())
}

/// Returns the names sorted by similarity to `wanted`, the most similar first.
pub(super) fn likeliest<'a>(names: Vec<&'a str>, wanted: &str) -> Vec<&'a str> {
    // Insertion, as in `svd`: for an error message, without the code of a sort.
    let mut sorted: Vec<(usize, &str)> = Vec::with_capacity(names.len());
    for name in names {
        let apart = distance(name, wanted);
        let at = sorted.partition_point(|&(before, _)| before <= apart);
        sorted.insert(at, (apart, name));
    }
    sorted.into_iter().map(|(_, name)| name).collect()
}

/// Returns the Levenshtein distance between the first hundred characters of two names, ignoring ASCII case.
fn distance(a: &str, b: &str) -> usize {
    let start = |name: &str| name.chars().take(100).collect::<String>().to_ascii_lowercase();
    strsim::levenshtein(&start(a), &start(b))
}
