//! Edge PSNR and block RMSE against their definitions, written down pixel by pixel.

use crate::common::{crop, image};
use gs3_evaluate::metrics::{
    DepthEdges, MetricError, Quantisation, block_rmse, block_rmse_p99, edge_psnr, psnr,
};
use gs3_scene::{Image, Planes, Size};

/// A picture and a damaged version of it, of a size that is no multiple of blocks, bands or vectors.
fn pair() -> (Image, Image) {
    let of = |name| crop(&image(name), 7, 11, 189, 149);
    (of("chelsea.png"), of("chelsea_test.png"))
}

/// Depths with steps of every kind: two surfaces a tenth apart and a little more, nothing, what is no depth, a slope.
fn depth(width: usize, height: usize) -> Planes<1> {
    let mut depth = Planes::new(width, height);
    for y in 0..height {
        for x in 0..width {
            depth.data_mut()[y * width + x] = match (x / 26, y / 30) {
                // A slope of 9 % a pixel is one surface; the column beside it is not.
                (0, 0) => 1.09f32.powi(x as i32 % 20),
                (1, 1) => 1.0,
                (2, 1) => 1.099,
                (3, 1) => 1.25,
                (4, _) => 0.0,
                (5, 2) => f32::NAN,
                (5, 3) => -1.0,
                (5, 4) => f32::INFINITY,
                (6, _) if x % 17 == 3 && y % 23 == 5 => 2.0,
                _ => 4.0,
            };
        }
    }
    depth
}

/// The definition: some pixel within two columns and two rows has a neighbour across a step.
fn is_near(depth: &Planes<1>, x: usize, y: usize) -> bool {
    let (width, height) = (depth.width() as isize, depth.height() as isize);
    let at = |x: isize, y: isize| {
        let value = depth.row(0, y as usize)[x as usize];
        if value.is_finite() && value > 0.0 { value } else { f32::INFINITY }
    };
    let inside = |x: isize, y: isize| (0..width).contains(&x) && (0..height).contains(&y);
    let on_step = |x: isize, y: isize| {
        [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().any(|(dx, dy)| {
            inside(x + dx, y + dy) && {
                let (a, b) = (at(x, y), at(x + dx, y + dy));
                a != b && a.max(b) > 1.1 * a.min(b)
            }
        })
    };
    let near = |centre: usize| centre as isize - 2..=centre as isize + 2;
    near(y).any(|v| near(x).any(|u| inside(u, v) && on_step(u, v)))
}

fn shown(value: f32, quantisation: Quantisation) -> f64 {
    let value = f64::from(if value > 0.0 { value.min(1.0) } else { 0.0 });
    match quantisation {
        Quantisation::None => value,
        Quantisation::EightBit => (value * 255.0 + 0.5).floor() / 255.0,
    }
}

#[test]
fn pixels_near_discontinuities_are_those_of_the_definition() {
    let depth = depth(189, 149);
    let edges = DepthEdges::of(&depth);
    let expected: Vec<bool> = (0..189 * 149).map(|i| is_near(&depth, i % 189, i / 189)).collect();
    assert_eq!(edges.pixels(), expected);
    let share = expected.iter().filter(|near| **near).count() as f64 / expected.len() as f64;
    assert!((edges.share() - share).abs() < 1e-12 && (0.1..0.6).contains(&share), "{share}");
}

#[test]
fn edge_psnr_is_the_psnr_of_those_pixels() {
    let ((reference, test), depth) = (pair(), depth(189, 149));
    for quantisation in [Quantisation::None, Quantisation::EightBit] {
        let (mut sum, mut count) = (0.0, 0);
        for (y, x) in (0..149).flat_map(|y| (0..189).map(move |x| (y, x))) {
            if is_near(&depth, x, y) {
                for c in 0..3 {
                    let [a, b] = [&reference, &test].map(|i| shown(i.row(y)[x][c], quantisation));
                    sum += (a - b) * (a - b);
                    count += 1;
                }
            }
        }
        let expected = -10.0 * (sum / f64::from(count)).log10();
        let actual = edge_psnr(&reference, &test, &DepthEdges::of(&depth), quantisation).unwrap().unwrap();
        // f32 differences of f32 pixels.
        assert!((actual - expected).abs() < 1e-5, "{actual} {expected}");
        assert!((actual - psnr(&reference, &test, quantisation).unwrap()).abs() > 0.01, "as the whole image");
    }
}

#[test]
fn block_rmse_is_the_error_of_each_block_and_its_99th_percentile() {
    let (reference, test) = pair();
    for quantisation in [Quantisation::None, Quantisation::EightBit] {
        let mut expected = Vec::new();
        for top in (0..149).step_by(8) {
            for left in (0..189).step_by(8) {
                let (mut sum, mut count) = (0.0, 0);
                for (y, x) in (top..top + 8).flat_map(|y| (left..left + 8).map(move |x| (y, x))) {
                    if x < 189 && y < 149 {
                        for c in 0..3 {
                            let [a, b] = [&reference, &test].map(|i| shown(i.row(y)[x][c], quantisation));
                            sum += (a - b) * (a - b);
                            count += 1;
                        }
                    }
                }
                expected.push((sum / f64::from(count)).sqrt() * 255.0);
            }
        }
        let actual = block_rmse(&reference, &test, quantisation).unwrap();
        assert_eq!(actual.len(), 19 * 24);
        for (a, e) in actual.iter().zip(&expected) {
            // f32 differences; a value at a rounding boundary may fall to either side, 1/192 of a block's square.
            assert!((a - e).abs() < 1e-3 || quantisation == Quantisation::EightBit && (a - e).abs() < 0.08);
        }
        let p99 = block_rmse_p99(&reference, &test, quantisation).unwrap();
        let worse = |than: f64| actual.iter().filter(|v| **v > than).count();
        // Of 456 blocks in order it lies at rank 450.45, between the 451st and the 452nd.
        assert_eq!((worse(p99), actual.contains(&p99)), (5, false));
    }
}

#[test]
fn the_percentile_lies_between_blocks_as_numpy_puts_it() {
    // Errors 0, 1, …, 199 of 255 in blocks of one colour: numpy.percentile(range(200), 99) is 197.01.
    let mut test = Image::new(8 * 200, 8);
    for y in 0..8 {
        for x in 0..8 * 200 {
            test.pixels_mut()[y * 1600 + x] = [(x / 8) as f32 / 255.0; 4];
        }
    }
    let p99 = block_rmse_p99(&Image::new(1600, 8), &test, Quantisation::None).unwrap();
    assert!((p99 - 197.01).abs() < 1e-4, "{p99}");
}

#[test]
fn equal_images_flat_depths_and_sizes_that_differ() {
    let (reference, test) = pair();
    let edges = DepthEdges::of(&depth(189, 149));
    let none = Quantisation::None;
    assert_eq!(edge_psnr(&reference, &reference, &edges, none), Ok(Some(f64::INFINITY)));
    assert_eq!(block_rmse_p99(&reference, &reference, none), Ok(0.0));
    let flat = DepthEdges::of(&Planes::new(189, 149));
    assert_eq!((edge_psnr(&reference, &test, &flat, none), flat.share()), (Ok(None), 0.0));
    let size = |what, actual: [u32; 2]| {
        Err(MetricError::Size { what, expected: Size::new(189, 149), actual: actual.into() })
    };
    let other = crop(&test, 0, 0, 188, 149);
    assert_eq!(edge_psnr(&reference, &other, &edges, none), size("test image", [188, 149]));
    let narrow = DepthEdges::of(&depth(188, 149));
    assert_eq!(edge_psnr(&reference, &test, &narrow, none), size("depth edges", [188, 149]));
    assert!(matches!(block_rmse(&reference, &other, none), Err(MetricError::Size { .. })));
    let empty = Image::new(0, 0);
    assert!(matches!(block_rmse_p99(&empty, &empty, none), Err(MetricError::TooSmall { .. })));
    assert_eq!(edge_psnr(&empty, &empty, &DepthEdges::of(&Planes::new(0, 0)), none), Ok(None));
}
