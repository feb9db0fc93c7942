//! The Python face: borrow the arrays, release the interpreter, solve, wrap the answer.

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::cost::Metric;
use crate::matrix::Matrix;
use crate::scan::Workers;
use crate::{OtError, Solution, between_numbers, between_points, with_cost};

type Weights<'py> = Option<PyReadonlyArray1<'py, f64>>;
type Floats<'py> = Bound<'py, PyArray1<f64>>;
type Indices<'py> = Bound<'py, PyArray1<i64>>;
/// Cost, rows, columns, masses, potentials of both sides, gap.
type Answer<'py> = (f64, Indices<'py>, Indices<'py>, Floats<'py>, Floats<'py>, Floats<'py>, f64);

fn wrap(py: Python<'_>, solution: Solution) -> Answer<'_> {
    (
        solution.cost,
        solution.rows.into_pyarray(py),
        solution.cols.into_pyarray(py),
        solution.mass.into_pyarray(py),
        solution.alpha.into_pyarray(py),
        solution.beta.into_pyarray(py),
        solution.gap,
    )
}

/// Runs a solver without the interpreter; pending signals (Ctrl-C) stop it.
fn run(
    py: Python<'_>,
    solve: impl FnOnce(&mut dyn FnMut() -> bool) -> Result<Solution, OtError> + Send,
) -> PyResult<Answer<'_>> {
    let mut signal = None;
    let result = py.detach(|| {
        solve(&mut || match Python::attach(|py| py.check_signals()) {
            Ok(()) => true,
            Err(error) => {
                signal = Some(error);
                false
            }
        })
    });
    match (result, signal) {
        (Ok(solution), _) => Ok(wrap(py, solution)),
        (Err(_), Some(error)) => Err(error),
        (Err(error), None) => Err(to_python(py, &error)),
    }
}

/// The package's own exception for an error of the solver.
fn to_python(py: Python<'_>, error: &OtError) -> PyErr {
    let name = match error {
        OtError::BadInput(_) => "BadInput",
        OtError::NotOptimal(_) => "NotOptimal",
        OtError::Interrupted => return PyRuntimeError::new_err("interrupted"),
    };
    let text = error.to_string();
    match py.import("nfpde.errors").and_then(|module| module.getattr(name)?.call1((text,))) {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

fn metric_of(name: &str) -> PyResult<Metric> {
    match name {
        "euclidean" => Ok(Metric::Euclidean),
        "sqeuclidean" => Ok(Metric::SqEuclidean),
        "cityblock" => Ok(Metric::CityBlock),
        other => Err(PyValueError::new_err(format!("unknown metric {other:?}"))),
    }
}

fn slice_of<'a>(weights: &'a Weights<'_>) -> PyResult<Option<&'a [f64]>> {
    Ok(weights.as_ref().map(|w| w.as_slice()).transpose()?)
}

/// Exact transport between points; C-contiguous float64 arrays of shape (n, d), (m, d), (n,), (m,).
#[pyfunction]
#[pyo3(signature = (x, y, a, b, metric, threads))]
fn solve_points<'py>(
    py: Python<'py>,
    x: PyReadonlyArray2<'py, f64>,
    y: PyReadonlyArray2<'py, f64>,
    a: Weights<'py>,
    b: Weights<'py>,
    metric: &str,
    threads: usize,
) -> PyResult<Answer<'py>> {
    let metric = metric_of(metric)?;
    let dim = x.shape()[1];
    if y.shape()[1] != dim {
        return Err(PyValueError::new_err("x and y differ in their second dimension"));
    }
    let (x, y) = (x.as_slice()?, y.as_slice()?);
    let weights = (slice_of(&a)?, slice_of(&b)?);
    run(py, |go_on| between_points(x, y, dim, metric, weights, &Workers::new(threads)?, go_on))
}

/// Exact transport between numbers at most about one apart, at the cost |x - y|^order; contiguous float64 arrays.
#[pyfunction]
#[pyo3(signature = (x, y, a, b, order))]
fn solve_numbers<'py>(
    py: Python<'py>,
    x: PyReadonlyArray1<'py, f64>,
    y: PyReadonlyArray1<'py, f64>,
    a: Weights<'py>,
    b: Weights<'py>,
    order: f64,
) -> PyResult<Answer<'py>> {
    let (x, y) = (x.as_slice()?, y.as_slice()?);
    let weights = (slice_of(&a)?, slice_of(&b)?);
    run(py, |go_on| between_numbers(x, y, order, weights, go_on))
}

/// Exact transport for a C-contiguous float64 cost matrix of shape (n, m).
#[pyfunction]
#[pyo3(signature = (cost, a, b, threads))]
fn solve_matrix<'py>(
    py: Python<'py>,
    cost: PyReadonlyArray2<'py, f64>,
    a: Weights<'py>,
    b: Weights<'py>,
    threads: usize,
) -> PyResult<Answer<'py>> {
    let cols = cost.shape()[1];
    let costs = cost.as_slice()?;
    let weights = (slice_of(&a)?, slice_of(&b)?);
    run(py, |go_on| with_cost(&Matrix::new(costs, cols)?, weights, &Workers::new(threads)?, go_on))
}

/// Exact optimal transport; called through nfpde.ot.
#[pymodule]
fn _rust_ot(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(solve_points, module)?)?;
    module.add_function(wrap_pyfunction!(solve_numbers, module)?)?;
    module.add_function(wrap_pyfunction!(solve_matrix, module)?)?;
    Ok(())
}
