//! Checked access to JSON values: every error names the field by its full path.

use serde_json::Value;

use super::CaptureFault;
use crate::format::quoted;

/// A JSON value and its place in the file.
pub struct Field<'a> {
    place: String,
    value: &'a Value,
}

impl<'a> Field<'a> {
    /// The whole document.
    pub fn root(value: &'a Value) -> Self {
        Self { place: String::new(), value }
    }

    /// The place, as `frames[3].fl_x`.
    pub fn place(&self) -> &str {
        if self.place.is_empty() { "document" } else { &self.place }
    }

    /// The member `key`, if this is an object that has it.
    pub fn get(&self, key: &str) -> Option<Self> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        Some(Self { place: self.member(key), value })
    }

    /// The member `key`.
    pub fn require(&self, key: &str, expected: &str) -> Result<Self, CaptureFault> {
        self.get(key).ok_or_else(|| CaptureFault::field(&self.member(key), expected, "nothing"))
    }

    /// The elements of this array.
    pub fn elements(&self) -> Result<impl ExactSizeIterator<Item = Self> + use<'_, 'a>, CaptureFault> {
        let array = self.value.as_array().ok_or_else(|| self.wrong("an array"))?;
        let element = |(i, value)| Self { place: format!("{}[{i}]", self.place), value };
        Ok(array.iter().enumerate().map(element))
    }

    /// This value as a finite number.
    pub fn number(&self) -> Result<f64, CaptureFault> {
        self.value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| self.wrong("a finite number"))
    }

    /// The member `key` as a finite number.
    pub fn number_of(&self, key: &str) -> Result<f64, CaptureFault> {
        self.require(key, "a finite number")?.number()
    }

    /// This value as a positive number of pixels; the camera checks the upper limit.
    pub fn pixels(&self) -> Result<u32, CaptureFault> {
        // Some tools write sizes as 1920.0.
        let value = self.number()?;
        if value.fract() == 0.0 && value >= 1.0 && value <= f64::from(u32::MAX) {
            Ok(value as u32)
        } else {
            Err(self.wrong("a positive whole number of pixels"))
        }
    }

    /// This value as text.
    pub fn text(&self) -> Result<&'a str, CaptureFault> {
        self.value.as_str().ok_or_else(|| self.wrong("text"))
    }

    /// This value as a flag.
    pub fn flag(&self) -> Result<bool, CaptureFault> {
        self.value.as_bool().ok_or_else(|| self.wrong("true or false"))
    }

    /// This value as a flag, which some programs write as a number.
    pub fn truth(&self) -> Result<bool, CaptureFault> {
        match (self.value.as_bool(), self.value.as_f64()) {
            (Some(flag), _) => Ok(flag),
            (None, Some(number)) => Ok(number != 0.0),
            (None, None) => Err(self.wrong("true or false")),
        }
    }

    /// The members of this object that are not in `known`, if it is an object. Members that are false, 0 or null are
    /// ignored.
    pub fn unknown(&self, known: &[&str]) -> Vec<String> {
        let members = self.value.as_object().into_iter().flatten();
        let says_something =
            |value: &Value| !value.is_null() && value.as_bool() != Some(false) && value.as_f64() != Some(0.0);
        let unknown = members.filter(|(key, value)| !known.contains(&key.as_str()) && says_something(value));
        unknown.map(|(key, _)| quoted(key)).collect()
    }

    /// Whether this value is an array.
    pub fn is_array(&self) -> bool {
        self.value.is_array()
    }

    /// Whether this value is false or 0: what it names is not there.
    pub fn is_off(&self) -> bool {
        self.value.as_bool() == Some(false) || self.value.as_f64() == Some(0.0)
    }

    /// This array of exactly `N` numbers.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N], CaptureFault> {
        let elements = self.elements()?;
        if elements.len() != N {
            return Err(CaptureFault::field(
                self.place(),
                &format!("{N} numbers"),
                format!("{} values", elements.len()),
            ));
        }
        let mut numbers = [0.0; N];
        for (number, element) in numbers.iter_mut().zip(elements) {
            *number = element.number()?;
        }
        Ok(numbers)
    }

    /// This array of at least `ROWS` rows of exactly `COLUMNS` numbers; further rows (the last of a 4×4 matrix) are
    /// not read.
    pub fn matrix<const ROWS: usize, const COLUMNS: usize>(
        &self,
    ) -> Result<[[f64; COLUMNS]; ROWS], CaptureFault> {
        let rows = self.elements()?;
        if rows.len() < ROWS {
            return Err(CaptureFault::field(self.place(), &format!("{ROWS} rows"), rows.len()));
        }
        let mut matrix = [[0.0; COLUMNS]; ROWS];
        for (to, row) in matrix.iter_mut().zip(rows) {
            *to = row.numbers()?;
        }
        Ok(matrix)
    }

    /// The value in a few words, for an error message.
    pub fn describe(&self) -> String {
        match self.value {
            Value::Array(a) => format!("an array of {}", a.len()),
            Value::Object(o) => format!("an object with {} fields", o.len()),
            Value::String(s) if s.chars().count() > 40 => {
                format!("the text {:?}…", s.chars().take(40).collect::<String>())
            }
            other => other.to_string(),
        }
    }

    /// This array of any number of numbers.
    pub fn list(&self) -> Result<Vec<f64>, CaptureFault> {
        self.elements()?.map(|element| element.number()).collect()
    }

    /// An error that this value is not what was expected.
    pub fn wrong(&self, expected: &str) -> CaptureFault {
        CaptureFault::field(self.place(), expected, self.describe())
    }

    fn member(&self, key: &str) -> String {
        if self.place.is_empty() { key.into() } else { format!("{}.{key}", self.place) }
    }
}
