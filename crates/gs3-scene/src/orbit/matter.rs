//! Where matter is: a coarse grid over a scene, to look for free places in and clear views from.

use glam::DVec3;

use crate::scene::Scene;

/// Cells of a grid, at most about: 2²¹ are 16 MB, and cells of 8 cm in a captured room, 50 cm in a captured garden.
const CELLS: f64 = (1 << 21) as f64;

/// A grid of cubes over a box.
pub(super) struct Matter {
    low: DVec3,
    /// Side of a cell, in world units.
    side: f64,
    size: [usize; 3],
    cells: Vec<Cell>,
}

/// What is in a cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Optical depth of crossing the cell: opacity × area of the Gaussians in the cell, over the area of a side.
    depth: f32,
    /// Radius of the Gaussians in it, in world units: the mean, weighted as `depth`.
    radius: f32,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance from its start, in world units.
    pub distance: f64,
    /// Angle under which the radius of the Gaussians there is seen.
    pub blur: f64,
}

impl Matter {
    /// The matter of `scene` in the box from `low` to `high`.
    pub fn of(scene: &Scene, low: DVec3, high: DVec3) -> Self {
        let largest = (high - low).max_element().max(f64::MIN_POSITIVE);
        // A box without volume gets some.
        let extent = (high - low).max(DVec3::splat(largest / 64.0));
        let side = (extent / largest).element_product().cbrt() * largest / CELLS.cbrt();
        let size = (extent / side).to_array().map(|cells| cells.ceil().max(1.0) as usize);
        let mut grid = Self { low, side, size, cells: vec![Cell::default(); size.iter().product()] };
        let gaussians = scene.gaussians();
        for i in 0..gaussians.len() {
            let area = area(gaussians.scale(i)) * f64::from(gaussians.opacities[i]);
            grid.add(DVec3::from(gaussians.mean(i).map(f64::from)), area);
        }
        for cell in &mut grid.cells {
            if cell.depth > 0.0 {
                cell.radius /= cell.depth;
            }
        }
        grid
    }

    /// Adds a Gaussian of this `area`, spread over as many cells as it is wide, so that walls have no holes.
    fn add(&mut self, mean: DVec3, area: f64) {
        /// Cells to each side, at most: larger Gaussians are background.
        const REACH: f64 = 2.0;
        let radius = (area / std::f64::consts::PI).sqrt();
        let reach = (radius / self.side).round().min(REACH) as i32;
        let width = 2 * reach + 1;
        let depth = (area / (self.side * self.side * f64::from(width.pow(3)))) as f32;
        for k in 0..width.pow(3) {
            let step = glam::IVec3::new(k % width, k / width % width, k / (width * width)) - reach;
            if let Some(index) = self.index(mean + self.side * step.as_dvec3()) {
                let cell = &mut self.cells[index];
                cell.depth += depth;
                cell.radius += depth * radius as f32;
            }
        }
    }

    fn index(&self, p: DVec3) -> Option<usize> {
        let at = (p - self.low) / self.side;
        let cell: [usize; 3] = at.to_array().map(|v| v as usize);
        let inside = at.cmpge(DVec3::ZERO).all() && (0..3).all(|axis| cell[axis] < self.size[axis]);
        inside.then(|| (cell[2] * self.size[1] + cell[1]) * self.size[0] + cell[0])
    }

    fn at(&self, p: DVec3) -> Cell {
        self.index(p).map_or_else(Cell::default, |index| self.cells[index])
    }

    /// Optical depth on the way from `a` to `b`.
    pub fn between(&self, a: DVec3, b: DVec3) -> f32 {
        let steps = ((b - a).length() / self.side).ceil().clamp(1.0, 1e4) as usize;
        (0..steps).map(|k| self.at(a.lerp(b, (k as f64 + 0.5) / steps as f64)).depth).sum()
    }

    /// What stops the ray from `eye` along the unit vector `direction` within the distance `far`: the point where its
    /// optical depth reaches 1.
    pub fn hit(&self, eye: DVec3, direction: DVec3, far: f64) -> Option<Hit> {
        let mut depth = 0.0;
        for k in 0..(far / self.side).clamp(0.0, 1e4) as usize {
            let distance = (k as f64 + 0.5) * self.side;
            let cell = self.at(eye + distance * direction);
            depth += cell.depth;
            if depth > 1.0 {
                return Some(Hit { distance, blur: f64::from(cell.radius) / distance });
            }
        }
        None
    }
}

/// Area of the Gaussian's disc of one standard deviation, seen from its broadest side.
pub(super) fn area(scale: [f32; 3]) -> f64 {
    let [a, b, c] = scale.map(f64::from);
    // The product of the two larger ones.
    std::f64::consts::PI * (a * b).max(b * c).max(c * a)
}
