//! Counts in rectangles of a grid, by sums over everything left of and above a corner.

/// Counts of items in rectangles of a grid.
#[derive(Debug, Default)]
pub(super) struct Counts {
    size: [usize; 2],
    /// Per corner between pixels, the number of items left of and above it: `[height + 1, width + 1]`.
    sums: Vec<u32>,
}

impl Counts {
    /// Counts the items that `all` passes on, as column and row, on a grid of `size`.
    pub fn set(&mut self, size: [usize; 2], all: impl FnOnce(&mut dyn FnMut([usize; 2]))) {
        let stride = size[0] + 1;
        self.size = size;
        self.sums.clear();
        self.sums.resize(stride * (size[1] + 1), 0);
        let sums = &mut self.sums;
        all(&mut |[x, y]| sums[(y + 1) * stride + x + 1] += 1);
        for y in 1..=size[1] {
            let mut in_row = 0;
            for x in 1..stride {
                in_row += self.sums[y * stride + x];
                self.sums[y * stride + x] = self.sums[(y - 1) * stride + x] + in_row;
            }
        }
    }

    /// Whether there are items from column and row `first` to before `end`.
    pub fn any(&self, first: [usize; 2], end: [usize; 2]) -> bool {
        let stride = self.size[0] + 1;
        let [end_x, end_y] = [end[0].min(self.size[0]), end[1].min(self.size[1])];
        let [x, y] = [first[0].min(end_x), first[1].min(end_y)];
        let at = |x: usize, y: usize| self.sums[y * stride + x];
        at(end_x, end_y) + at(x, y) > at(x, end_y) + at(end_x, y)
    }
}
