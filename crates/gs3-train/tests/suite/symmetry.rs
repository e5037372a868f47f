//! Clips laid down in eight ways are clips of a world laid down so.

use crate::common::{SCALE, clip};
use gs3_train::clip::Symmetry;
use gs3_train::{Clip, Network};
use half::f16;

const LR: [usize; 2] = [9, 12];

fn plane<'a>(clip: &'a mut Clip, frame: usize, name: &str) -> &'a mut Vec<f16> {
    &mut clip.frames[frame].inputs.iter_mut().find(|plane| plane.name == name).unwrap().values
}

/// A clip of a smooth surface, as seen by samples off the pixel centres, that moves: its planes have to agree.
fn surface() -> Clip {
    let mut clip = clip(Network::SuperSample, 2, LR, 1);
    let [dx, dy] = [1.0, -2.0];
    // Twice differentiable and without symmetry; frame 1 is frame 0 moved by (−dx, −dy).
    let height = |x: f32, y: f32| 0.002 * (x + 2.0 * y) + 0.001 * (x * x - 1.7 * x * y + 0.3 * y * y);
    let slope = |x: f32, y: f32| [0.002 + 0.002 * x - 0.0017 * y, 0.004 - 0.0017 * x + 0.0006 * y];
    for frame in 0..2 {
        let jitter = [0.25, -0.125 * frame as f32];
        let place = |k: usize| {
            let (x, y) = ((k % LR[1]) as f32 + jitter[0], (k / LR[1]) as f32 + jitter[1]);
            [x + dx * frame as f32, y + dy * frame as f32]
        };
        let each = |f: &dyn Fn(usize) -> Vec<f32>| -> Vec<f16> {
            (0..LR[0] * LR[1]).flat_map(f).map(f16::from_f32).collect()
        };
        *plane(&mut clip, frame, "color") = each(&|k| vec![height(place(k)[0], place(k)[1]); 3]);
        *plane(&mut clip, frame, "gradients") = each(&|k| {
            let [gx, gy] = slope(place(k)[0], place(k)[1]);
            vec![gx, gx, gx, gy, gy, gy]
        });
        *plane(&mut clip, frame, "jitter") = each(&|_| jitter.to_vec());
        *plane(&mut clip, frame, "motion") = each(&|_| vec![dx, dy]);
    }
    clip
}

/// Differences of neighbouring samples are what their derivatives say, and of a pixel and its past what jitter and
/// derivatives say.
fn check(clip: &mut Clip) {
    let [height, width] = clip.lr;
    let frames: Vec<[Vec<f32>; 4]> = (0..2)
        .map(|frame| {
            ["color", "gradients", "jitter", "motion"]
                .map(|name| plane(clip, frame, name).iter().map(|v| v.to_f32()).collect())
        })
        .collect();
    let [color, gradients, jitter, motion] = &frames[1];
    let [color_before, _, jitter_before, _] = &frames[0];
    let mut pasts = 0;
    for y in 0..height - 1 {
        for x in 0..width - 1 {
            let k = y * width + x;
            let mean = |next: usize, c: usize| 0.5 * (gradients[6 * k + c] + gradients[6 * next + c]);
            let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-3, "({x}, {y}): {a} is not {b}");
            close(color[3 * (k + 1)] - color[3 * k], mean(k + 1, 0));
            close(color[3 * (k + width)] - color[3 * k], mean(k + width, 3));
            let [was_x, was_y] = [x as f32 + motion[2 * k], y as f32 + motion[2 * k + 1]];
            if (0.0..width as f32).contains(&was_x) && (0.0..height as f32).contains(&was_y) {
                let was = was_y as usize * width + was_x as usize;
                let moved = [0, 1].map(|c| jitter[2 * k + c] - jitter_before[2 * was + c]);
                let change = gradients[6 * k] * moved[0] + gradients[6 * k + 3] * moved[1];
                close(color[3 * k] - color_before[3 * was], change);
                pasts += 1;
            }
        }
    }
    assert!(pasts > 50, "{pasts} pixels have a past");
}

#[test]
fn planes_agree_in_every_symmetry() {
    for symmetry in Symmetry::ALL {
        let mut clip = symmetry.apply(surface());
        clip.check().unwrap();
        check(&mut clip);
    }
    // The check sees a sign that is wrong.
    let mut wrong = Symmetry { mirrored_x: true, ..Symmetry::default() }.apply(surface());
    plane(&mut wrong, 1, "gradients").iter_mut().for_each(|v| *v = -*v);
    assert!(std::panic::catch_unwind(move || check(&mut wrong)).is_err());
}

#[test]
fn high_resolution_goes_with_low_resolution() {
    let clip = clip(Network::SuperSample, 1, LR, 2);
    let symmetry = Symmetry { transposed: true, mirrored_x: true, mirrored_y: false };
    let turned = symmetry.apply(clip.clone());
    assert_eq!(turned.lr, [LR[1], LR[0]]);
    let target = |clip: &Clip, x: usize, y: usize| {
        let k = 3 * (y * clip.lr[1] * SCALE as usize + x);
        clip.frames[0].target[k..k + 3].to_vec()
    };
    // Transposed, (3, 5) is (5, 3); mirrored in 18 columns, (12, 3).
    assert_eq!(target(&turned, 18 - 1 - 5, 3), target(&clip, 3, 5));
    // A quarter turn; four of them are none.
    let four = (0..4).fold(clip.clone(), |clip, _| symmetry.apply(clip));
    assert!(four == clip);
    let all: Vec<Clip> = Symmetry::ALL.map(|symmetry| symmetry.apply(clip.clone())).to_vec();
    assert!((0..8).all(|a| (0..a).all(|b| all[a] != all[b])), "two of them are the same");
}
