//! The log of a training: a table in CSV.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use gs3_files::write_atomically;

use crate::error::TrainError;
use crate::losses::{Term, Terms};

/// A row of the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Steps made.
    pub step: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// Learning rate.
    pub rate: f64,
    /// Mean loss since the last row.
    pub loss: f64,
    /// Mean terms since the last row.
    pub terms: Terms,
    /// Mean length of the derivative since the last row.
    pub gradient: f64,
    /// Mean gains in PSNR and tPSNR on held-out clips, dB, if they were looked at.
    pub gains: Option<[f64; 2]>,
}

/// A log file and what it holds.
#[derive(Clone, Debug)]
pub struct Log {
    path: PathBuf,
    rows: Vec<Row>,
}

impl Log {
    /// The log at `path` up to `step`, where the training goes on; an empty one where there is none.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be read or written.
    pub fn open(path: &Path, step: u64) -> Result<Self, TrainError> {
        let file = |source| TrainError::File { path: path.to_owned(), source };
        let text = if path.exists() { fs::read_to_string(path).map_err(file)? } else { String::new() };
        let rows: Vec<Row> = read(&text).into_iter().filter(|row| row.step <= step).collect();
        let text: String = std::iter::once(header()).chain(rows.iter().map(write)).collect();
        write_atomically(path, |writer| writer.write_all(text.as_bytes())).map_err(file)?;
        Ok(Self { path: path.to_owned(), rows })
    }

    /// Adds a row to the file.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be written.
    pub fn add(&mut self, row: Row) -> Result<(), TrainError> {
        let file = |source| TrainError::File { path: self.path.clone(), source };
        let mut out = OpenOptions::new().append(true).open(&self.path).map_err(file)?;
        out.write_all(write(&row).as_bytes()).map_err(file)?;
        self.rows.push(row);
        Ok(())
    }

    /// All rows, oldest first.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }
}

fn header() -> String {
    let terms: Vec<&str> = Term::ALL.map(Term::name).to_vec();
    format!("step,seconds,rate,loss,{},gradient,psnr_gain,tpsnr_gain\n", terms.join(","))
}

fn write(row: &Row) -> String {
    let terms: Vec<String> = Term::ALL.map(|term| format!("{:.6e}", row.terms.get(term))).to_vec();
    let gains = row.gains.map_or(",".to_owned(), |[psnr, tpsnr]| format!("{psnr:.4},{tpsnr:.4}"));
    let Row { step, seconds, rate, loss, gradient, .. } = row;
    format!("{step},{seconds:.1},{rate:.4e},{loss:.6e},{},{gradient:.4e},{gains}\n", terms.join(","))
}

/// The rows of a log, with its columns in any order. Values without a column are 0. Truncated lines are not rows.
fn read(text: &str) -> Vec<Row> {
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        if fields.len() != columns.len() {
            return None;
        }
        let field = |name: &str| columns.iter().position(|column| *column == name).map(|k| fields[k]);
        let number = |name: &str| field(name).and_then(|field| field.parse::<f64>().ok());
        let mut terms = Terms::default();
        for term in Term::ALL {
            terms.set(term, number(term.name()).unwrap_or(0.0));
        }
        Some(Row {
            step: field("step")?.parse().ok()?,
            seconds: number("seconds")?,
            rate: number("rate")?,
            loss: number("loss")?,
            terms,
            gradient: number("gradient")?,
            gains: number("psnr_gain").zip(number("tpsnr_gain")).map(|(psnr, tpsnr)| [psnr, tpsnr]),
        })
    };
    lines.filter_map(row).collect()
}
