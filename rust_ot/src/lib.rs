//! Exact optimal transport between weighted point sets; every answer carries the proof that it is optimal.
//!
//! [`between_points`] and [`with_cost`] are the entry points; `python` is the only module that knows Python.
#![deny(unsafe_code)]

pub mod certificate;
pub mod cost;
pub mod error;
pub mod masses;
pub mod network_simplex;
pub mod one_dim;
mod python;
pub mod solution;
pub mod transport;
pub mod tree;
pub mod watch;

pub use error::OtError;
pub use solution::Solution;
pub use transport::{between_points, with_cost};
