//! Culling: three methods that may not lose anything, two that lose exactly what their papers say.

use glam::DVec2;
use gs3_raster::{Culling, RasterSettings, matched_dilation};
use gs3_scene::OpacityMode;

use crate::compare::{EVERYTHING, EXACT_CULLING, assert_identical, oracle, render};
use crate::oracle::Splat;
use crate::scenes::{RandomScene, camera_at_origin, posed, tilted_pose};

#[test]
fn exact_methods_agree_bit_for_bit() {
    for seed in 0..40 {
        let [width, height] = [[1, 1], [33, 47], [130, 70], [300, 9]][seed as usize % 4];
        let camera = posed(&camera_at_origin(width, height, DVec2::new(0.05, 0.1)), tilted_pose());
        let mode = if seed % 2 == 0 { OpacityMode::Default } else { OpacityMode::Antialiased };
        let anisotropy = [2.0, 30.0, 1e4][seed as usize % 3];
        let recipe = RandomScene {
            seed,
            opacity_mode: mode,
            anisotropy,
            count: 400,
            sigma: [0.1, 40.0],
            ..RandomScene::BASE
        };
        let scene = recipe.build(&camera);
        for dilation in [0.3, matched_dilation(4), 0.0] {
            let settings = RasterSettings { dilation, jitter: [0.21, -0.37], ..EVERYTHING };
            let [snug, accu, exact] = EXACT_CULLING.map(|c| render(&scene, c, &camera, &settings));
            assert_identical(
                &snug,
                &accu,
                &format!("SnugBox and AccuTile, seed {seed}, dilation {dilation}"),
            );
            assert_identical(&snug, &exact, &format!("SnugBox and Exact, seed {seed}, dilation {dilation}"));
        }
    }
}

/// Half the sides in pixels of the box that `culling` keeps of `splat`.
fn published_half_extents(culling: Culling, splat: &Splat) -> [f64; 2] {
    let [xx, xy, yy] = splat.covariance;
    if culling == Culling::Aabb3Sigma {
        let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        return [(3.0 * largest.sqrt()).ceil(); 2];
    }
    let support = (2.0 * (255.0 * splat.opacity).ln()).max(0.0);
    [xx, yy].map(|variance| (3.0 * variance.sqrt()).min((support * variance).sqrt().ceil()))
}

/// Whether a box around the splat touches the 16×16 tile of pixel `(i, j)`; `slack` px are added on every side.
fn touches(culling: Culling, splat: &Splat, i: usize, j: usize, slack: f64) -> bool {
    let half = published_half_extents(culling, splat);
    [i, j].iter().zip(splat.mean).zip(half).all(|((pixel, mean), half)| {
        let low = (pixel / 16 * 16) as f64;
        low < mean + half + slack && mean - half - slack < low + 16.0
    })
}

/// The 3σ methods against the oracle with their rule. A pixel that a box 1.5 pixels larger or smaller
/// would change is left out: the published codes measure from pixel centres and round whole tiles down.
#[test]
fn three_sigma_methods_lose_what_is_published() {
    for culling in [Culling::Aabb3Sigma, Culling::Adr] {
        let (mut squares, mut compared, mut lossy, mut unclear, mut worst) = (0.0, 0, 0, 0, 0.0_f64);
        for seed in 300..306 {
            let camera = camera_at_origin(150, 110, DVec2::ZERO);
            // σ up to 12 px: the rim from 3σ to 3.33σ is up to 4 px wide, so whole tiles of it go missing.
            let recipe =
                RandomScene { seed, count: 80, sigma: [2.0, 12.0], anisotropy: 4.0, ..RandomScene::BASE };
            let scene = recipe.build(&camera);
            let oracle = oracle(&scene, &camera, &EVERYTHING);
            let frame = render(&scene, culling, &camera, &EVERYTHING);
            for (i, j) in (0..110).flat_map(|j| (0..150).map(move |i| (i, j))) {
                let at = |slack: f64| oracle.pixel_of(i, j, |s| touches(culling, s, i, j, slack));
                let (expected, full) = (at(0.0), oracle.pixel(i, j));
                if full.cut_offs.any() || expected.cut_offs.any() {
                    continue;
                }
                if at(-1.5).color != at(1.5).color {
                    unclear += 1;
                    continue;
                }
                for c in 0..3 {
                    let actual = f64::from(frame.color.row(c, j)[i]);
                    assert!(
                        (actual - expected.color[c]).abs() < 1e-4,
                        "{culling:?} seed {seed} pixel ({i}, {j}): expected {}, found {actual}, without loss {}",
                        expected.color[c],
                        full.color[c],
                    );
                    let loss = (expected.color[c] - full.color[c]).abs();
                    squares += loss * loss / 3.0;
                    worst = worst.max(loss);
                }
                compared += 1;
                lossy += usize::from(expected.color != full.color);
            }
        }
        let psnr = -10.0 * (squares / f64::from(compared)).log10();
        eprintln!(
            "{culling:?}: {lossy} of {compared} pixels lose something, at most {worst:.4}, {psnr:.1} dB against the \
             full support; {unclear} left out"
        );
        assert!(lossy > 0, "{culling:?} lost nothing: the test does not see its rim");
        // One lost contribution is below e^(−4.5) = 0.0111 of a colour that degree 0 keeps below 1; the rim's other
        // layers weaken it.
        assert!(worst < 0.0111, "{culling:?} loses {worst}");
        assert!(psnr > 70.0, "{culling:?}: {psnr} dB");
        assert!(unclear * 5 < compared, "{culling:?}: {unclear} unclear of {compared}");
    }
}

/// 3σ is exact where the support lies within it: there the picture has the same bits as with the exact methods.
#[test]
fn faint_splats_lose_nothing_at_three_sigma() {
    let camera = camera_at_origin(150, 110, DVec2::ZERO);
    let mut specs = RandomScene { count: 200, sigma: [4.0, 16.0], ..RandomScene::BASE }.specs(&camera);
    for s in &mut specs {
        // The support of o = 0.05 ends at √(2 ln 12.75) = 2.26σ: 1.5 px of slack at σ = 2 px, and more above.
        s.opacity *= 0.05;
    }
    let scene = crate::scenes::scene(&specs, 0);
    let exact = render(&scene, Culling::Exact, &camera, &EVERYTHING);
    assert_identical(&exact, &render(&scene, Culling::Aabb3Sigma, &camera, &EVERYTHING), "faint");
}
