//! Exact optimal transport between weighted point sets; every answer carries the proof that it is optimal.
//!
//! [`between_points`], [`between_numbers`] and [`with_cost`] are the entry points; `python` is the only module that knows Python.
#![deny(unsafe_code)]

pub mod arcs;
pub mod assignment;
pub mod candidates;
pub mod careful;
pub mod certificate;
pub mod clipped;
pub mod coarse;
pub mod coarse_to_fine;
pub mod cost;
pub mod error;
pub mod few_columns;
pub mod forest;
pub mod line;
pub mod mass;
pub mod masses;
pub mod matrix;
pub mod merge;
pub mod network_simplex;
pub mod one_dim;
pub mod points;
pub mod precise;
mod python;
pub mod scan;
mod simd;
pub mod solution;
pub mod sparse_assignment;
pub mod sparse_transport;
pub mod stored;
pub mod threaded_tree;
pub mod transport;
pub mod tree;
pub mod watch;

pub use error::OtError;
pub use solution::Solution;
pub use transport::{between_numbers, between_points, with_cost};
