//! Python binding of `pliant-core`.
