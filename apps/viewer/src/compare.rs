//! Methods side by side, of the same camera.

use gs3::Mode;

/// What a part of the picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparedMethod {
    /// A frame that is no part of any history.
    Reference(Mode),
    /// The frame of the session.
    Gs3,
}

impl ComparedMethod {
    /// Its name in the picture.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reference(mode) => mode.name(),
            Self::Gs3 => "gs3",
        }
    }
}

/// What is compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compare {
    /// Nothing: gs3 alone.
    #[default]
    Off,
    /// Native beside gs3.
    Native,
    /// Bicubic beside gs3.
    Bicubic,
    /// Native, bicubic and gs3 in a row.
    All,
    /// How far gs3 is from native.
    Difference,
}

impl Compare {
    /// All of them, in the order in which keys go through them.
    pub const ALL: [Self; 5] = [Self::Off, Self::Native, Self::Bicubic, Self::All, Self::Difference];

    /// Its name in panels.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Native => "native | gs3",
            Self::Bicubic => "bicubic | gs3",
            Self::All => "native | bicubic | gs3",
            Self::Difference => "difference to native, 8 times",
        }
    }

    /// The one after it.
    #[must_use]
    pub fn next(self) -> Self {
        let place = Self::ALL.iter().position(|compare| *compare == self).unwrap_or_default();
        Self::ALL[(place + 1) % Self::ALL.len()]
    }

    /// What is side by side, from left to right.
    #[must_use]
    pub const fn methods(self) -> &'static [ComparedMethod] {
        match self {
            Self::Off | Self::Difference => &[ComparedMethod::Gs3],
            Self::Native => &[ComparedMethod::Reference(Mode::Native), ComparedMethod::Gs3],
            Self::Bicubic => &[ComparedMethod::Reference(Mode::Bicubic), ComparedMethod::Gs3],
            Self::All => &[
                ComparedMethod::Reference(Mode::Native),
                ComparedMethod::Reference(Mode::Bicubic),
                ComparedMethod::Gs3,
            ],
        }
    }
}

/// Where the parts meet, as shares of the width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dividers {
    places: [f32; 2],
    /// The one that is dragged.
    dragged: Option<usize>,
}

impl Default for Dividers {
    fn default() -> Self {
        Self { places: [0.5, 2.0 / 3.0], dragged: None }
    }
}

impl Dividers {
    /// As many as `compare` has, evenly.
    #[must_use]
    pub const fn even(compare: Compare) -> Self {
        let places = match compare.methods().len() {
            3 => [1.0 / 3.0, 2.0 / 3.0],
            _ => [0.5, 1.0],
        };
        Self { places, dragged: None }
    }

    /// The first column of each part but the first, in a picture of `width`.
    pub fn columns(&self, compare: Compare, width: usize) -> impl Iterator<Item = usize> + use<> {
        let count = compare.methods().len() - 1;
        let column = move |share: f32| ((share * width as f32).round().max(0.0) as usize).min(width);
        self.places.into_iter().take(count).map(column)
    }

    /// Takes hold of the divider within `reach` pixels of column `x`, if there is one. Whether there is.
    pub fn grab(&mut self, compare: Compare, x: f32, reach: f32, width: usize) -> bool {
        let distance = |column: usize| (column as f32 - x).abs();
        let nearest = self
            .columns(compare, width)
            .map(distance)
            .enumerate()
            .filter(|(_, distance)| *distance <= reach)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        self.dragged = nearest.map(|(index, _)| index);
        self.dragged.is_some()
    }

    /// Moves the divider that is held to column `x`, if one is. Whether one is. They do not pass each other.
    pub fn drag(&mut self, x: f32, width: usize) -> bool {
        let Some(index) = self.dragged else { return false };
        let share = (x / width.max(1) as f32).clamp(0.0, 1.0);
        self.places[index] = if index == 0 { share.min(self.places[1]) } else { share.max(self.places[0]) };
        true
    }

    /// Lets go.
    pub const fn release(&mut self) {
        self.dragged = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dividers_are_grabbed_nearby_and_do_not_pass_each_other() {
        let mut dividers = Dividers::even(Compare::All);
        let columns = |dividers: &Dividers| dividers.columns(Compare::All, 300).collect::<Vec<_>>();
        assert_eq!(columns(&dividers), [100, 200]);
        assert!(!dividers.grab(Compare::All, 120.0, 6.0, 300) && !dividers.drag(130.0, 300));
        assert!(dividers.grab(Compare::All, 104.0, 6.0, 300) && dividers.drag(250.0, 300));
        assert_eq!(columns(&dividers), [200, 200]);
        dividers.drag(30.0, 300);
        dividers.release();
        assert!(!dividers.drag(90.0, 300));
        assert_eq!(columns(&dividers), [30, 200]);
        assert_eq!(dividers.columns(Compare::Off, 300).count(), 0);
        assert!(!dividers.grab(Compare::Off, 30.0, 6.0, 300));
        assert_eq!(Dividers::even(Compare::Native).columns(Compare::Native, 300).collect::<Vec<_>>(), [150]);
    }
}
