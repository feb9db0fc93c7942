//! Lets a caller stop a long search, and stops a search that does not end.

use crate::error::OtError;

const STEPS_BETWEEN_QUESTIONS: u64 = 4096;

/// Counts steps, now and then asks the caller whether to go on, and gives up after a limit.
pub struct Watch<'a> {
    go_on: &'a mut dyn FnMut() -> bool,
    steps: u64,
    limit: u64,
}

impl<'a> Watch<'a> {
    /// Asks `go_on`; `limit` is the largest number of steps.
    pub fn new(go_on: &'a mut dyn FnMut() -> bool, limit: u64) -> Self {
        Self { go_on, steps: 0, limit }
    }

    /// Steps so far.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Counts one step.
    ///
    /// # Errors
    /// `Interrupted` when the caller asks to stop, `NotOptimal` beyond the limit.
    #[inline]
    pub fn step(&mut self) -> Result<(), OtError> {
        self.steps += 1;
        if self.steps.is_multiple_of(STEPS_BETWEEN_QUESTIONS) { self.ask() } else { Ok(()) }
    }

    /// Asks the caller at once.
    ///
    /// # Errors
    /// As for [`Watch::step`].
    pub fn ask(&mut self) -> Result<(), OtError> {
        if !(self.go_on)() {
            return Err(OtError::Interrupted);
        }
        if self.steps > self.limit {
            return Err(OtError::NotOptimal(format!(
                "no optimum found within {} steps of the search; rescale the points or merge near-duplicates",
                self.limit
            )));
        }
        Ok(())
    }
}
