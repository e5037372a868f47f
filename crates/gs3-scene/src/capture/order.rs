//! The order of photos by name.

use std::cmp::Ordering;

/// Names in the order of the capture: digits compare as numbers, so that `frame_10` comes after `frame_2`. Names that
/// differ in leading zeros only have an order as well.
pub fn in_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    loop {
        let ((x, y), order) = match (left.first(), right.first()) {
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let ((x, left_rest), (y, right_rest)) = (number(left), number(right));
                // A number with more digits is larger.
                ((left_rest, right_rest), x.len().cmp(&y.len()).then(x.cmp(y)))
            }
            (Some(x), Some(y)) => ((&left[1..], &right[1..]), x.cmp(y)),
            (x, y) => return x.cmp(&y).then(a.cmp(b)),
        };
        if order.is_ne() {
            return order;
        }
        (left, right) = (x, y);
    }
}

/// The digits that `text` starts with, without leading zeros, and what follows.
fn number(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|c| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    let zeros = digits.iter().take_while(|digit| **digit == b'0').count();
    (&digits[zeros..], rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_compare_as_numbers() {
        let sorted = [
            "",
            "a",
            // Ties of numbers go by their text.
            "frame_01",
            "frame_1",
            "frame_2.png",
            "frame_2b",
            "frame_10",
            "frame_10a2",
            "frame_10a11",
            "frame_99999999999999999999999",
            "frame_100000000000000000000000",
            "frame_x",
            "g",
        ];
        let mut shuffled: Vec<&str> = sorted.iter().rev().copied().collect();
        shuffled.sort_by(|a, b| in_order(a, b));
        assert_eq!(shuffled, sorted);
    }
}
