//! What can go wrong, in words a caller can act on.

use std::fmt;

/// Why no answer is given.
#[derive(Clone, Debug, PartialEq)]
pub enum OtError {
    /// An argument breaks a rule; the text names the argument, the index and the rule.
    BadInput(String),
    /// The search ended without a plan whose optimality could be certified.
    NotOptimal(String),
    /// The caller asked to stop.
    Interrupted,
}

impl fmt::Display for OtError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BadInput(text) | Self::NotOptimal(text) => f.write_str(text),
            Self::Interrupted => f.write_str("interrupted"),
        }
    }
}

impl std::error::Error for OtError {}

/// Shorthand for [`OtError::BadInput`].
pub(crate) fn bad(text: String) -> OtError {
    OtError::BadInput(text)
}
