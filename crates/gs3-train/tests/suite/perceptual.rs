//! The perceptual loss against naive loops over the published network, and its derivative against finite differences.

use gs3_neural::Random;
use gs3_neural::arrays::{Array, Arrays};
use gs3_train::losses::{Interior, Perceptual};

/// Margin, and an interior of 36×32, which is seen as a whole.
const MARGIN: usize = 2;
const SIZE: [usize; 2] = [40, 36];

const LAYERS: [(&str, [usize; 3]); 13] = [
    ("conv1", [96, 3, 7]),
    ("fire2.conv1x1_1", [16, 96, 1]),
    ("fire2.conv1x1_2", [64, 16, 1]),
    ("fire2.conv3x3_2", [64, 16, 3]),
    ("fire3.conv1x1_1", [16, 128, 1]),
    ("fire3.conv1x1_2", [64, 16, 1]),
    ("fire3.conv3x3_2", [64, 16, 3]),
    ("fire4.conv1x1_1", [32, 128, 1]),
    ("fire4.conv1x1_2", [128, 32, 1]),
    ("fire4.conv3x3_2", [128, 32, 3]),
    ("fire5.conv1x1_1", [32, 256, 1]),
    ("fire5.conv1x1_2", [128, 32, 1]),
    ("fire5.conv3x3_2", [128, 32, 3]),
];

fn weights() -> Arrays {
    let mut random = Random::new(1);
    let mut arrays = Arrays::new();
    for (name, [outputs, inputs, kernel]) in LAYERS {
        let bound = (6.0 / (inputs * kernel * kernel) as f32).sqrt();
        let mut add = |name: String, shape: &[usize], bound: f32| {
            let values = (0..shape.iter().product()).map(|_| bound * random.signed()).collect();
            let array = Array::new(&name, shape, values).unwrap();
            arrays.insert(name, array);
        };
        add(format!("{name}.weight"), &[outputs, inputs, kernel, kernel], bound);
        add(format!("{name}.bias"), &[outputs], 0.1);
    }
    arrays
}

/// `[channels][height][width]`.
type Planes = Vec<Vec<Vec<f64>>>;

/// A convolution with a rectifier, as PyTorch's.
fn conv(arrays: &Arrays, name: &str, x: &Planes, stride: usize, padding: usize) -> Planes {
    let weight = &arrays[&format!("{name}.weight")];
    let (bias, kernel) = (arrays[&format!("{name}.bias")].values(), weight.shape()[2]);
    let (height, width) = (x[0].len(), x[0][0].len());
    let side = |side: usize| (side + 2 * padding - kernel) / stride + 1;
    let value = |o: usize, y: usize, x_at: usize| {
        let mut sum = f64::from(bias[o]);
        for (c, plane) in x.iter().enumerate() {
            for k in 0..kernel * kernel {
                let (row, column) = (stride * y + k / kernel, stride * x_at + k % kernel);
                let inside = (padding..height + padding).contains(&row)
                    && (padding..width + padding).contains(&column);
                if inside {
                    let w = weight.values()[(o * x.len() + c) * kernel * kernel + k];
                    sum += f64::from(w) * plane[row - padding][column - padding];
                }
            }
        }
        sum.max(0.0)
    };
    let row = |o, y| (0..side(width)).map(|x| value(o, y, x)).collect();
    (0..weight.shape()[0]).map(|o| (0..side(height)).map(|y| row(o, y)).collect()).collect()
}

fn fire(arrays: &Arrays, name: &str, x: &Planes) -> Planes {
    let x = conv(arrays, &format!("{name}.conv1x1_1"), x, 1, 0);
    let mut both = conv(arrays, &format!("{name}.conv1x1_2"), &x, 1, 0);
    both.extend(conv(arrays, &format!("{name}.conv3x3_2"), &x, 1, 1));
    both
}

/// MaxPool2d(kernel_size=3, stride=2, ceil_mode=True).
fn pool(x: &Planes) -> Planes {
    let pooled = |plane: &Vec<Vec<f64>>| {
        let (height, width) = (plane.len(), plane[0].len());
        let side = |side: usize| (side - 3).div_ceil(2) + 1;
        let largest = |y: usize, x: usize| {
            let rows = plane[2 * y..(2 * y + 3).min(height)].iter();
            rows.flat_map(|row| &row[2 * x..(2 * x + 3).min(width)]).fold(f64::MIN, |a, b| a.max(*b))
        };
        (0..side(height)).map(|y| (0..side(width)).map(|x| largest(y, x)).collect()).collect()
    };
    x.iter().map(pooled).collect()
}

/// Features after conv1, fire4 and fire5 of the interior of an HR image.
fn features(arrays: &Arrays, image: &[f32]) -> [Planes; 3] {
    let [mean, deviation] = [[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]];
    let value = |c: usize, y: usize, x: usize| {
        (f64::from(image[((y + MARGIN) * SIZE[1] + x + MARGIN) * 4 + c]) - mean[c]) / deviation[c]
    };
    let [height, width] = SIZE.map(|side| side - 2 * MARGIN);
    let row = |c, y| (0..width).map(|x| value(c, y, x)).collect();
    let image: Planes = (0..3).map(|c| (0..height).map(|y| row(c, y)).collect()).collect();
    let conv1 = conv(arrays, "conv1", &image, 2, 0);
    let x = fire(arrays, "fire3", &fire(arrays, "fire2", &pool(&conv1)));
    let fire4 = fire(arrays, "fire4", &x);
    let fire5 = fire(arrays, "fire5", &pool(&fire4));
    [conv1, fire4, fire5]
}

/// Relative mean squared differences.
fn expected(arrays: &Arrays, image: &[f32], truth: &[f32]) -> f64 {
    let (image, truth) = (features(arrays, image), features(arrays, truth));
    let relative = |(a, b): (&Planes, &Planes)| {
        let (a, b) = (a.iter().flatten().flatten(), b.iter().flatten().flatten());
        let square: f64 = b.clone().map(|b| b * b).sum();
        a.zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / square
    };
    image.iter().zip(&truth).map(relative).sum::<f64>() / 3.0
}

/// A smooth image, so that features differ, and another near it; the fourth channel is no colour.
fn images() -> [Vec<f32>; 2] {
    let mut random = Random::new(2);
    let truth: Vec<f32> = (0..SIZE[0] * SIZE[1] * 4)
        .map(|k| 0.5 + 0.3 * (0.05 * k as f32 + (k / (4 * SIZE[1])) as f32).sin() * f32::from(k % 4 < 3))
        .collect();
    let image = truth.iter().enumerate();
    [image.map(|(k, v)| if k % 4 < 3 { v + 0.1 * random.signed() } else { *v }).collect(), truth]
}

#[test]
fn it_is_that_of_the_published_network() {
    let interior = Interior::new(SIZE[0], SIZE[1], MARGIN).unwrap();
    let loss = Perceptual::new(&weights(), interior).unwrap();
    let [image, truth] = images();
    let error: Vec<f32> = image.iter().zip(&truth).map(|(a, b)| a - b).collect();
    let (mut memory, mut v) = (loss.memory(), vec![0.0; image.len()]);
    let actual = loss.add(&image, &error, 1.0, &mut memory, &mut v).unwrap();
    let expected = expected(&weights(), &image, &truth);
    assert!((actual / expected - 1.0).abs() < 1e-4, "{actual} is not {expected}");
    assert_eq!(loss.add(&truth, &vec![0.0; image.len()], 1.0, &mut memory, &mut v).unwrap(), 0.0);
}

#[test]
fn it_has_its_derivative() {
    let interior = Interior::new(SIZE[0], SIZE[1], MARGIN).unwrap();
    let loss = Perceptual::new(&weights(), interior).unwrap();
    let [image, truth] = images();
    let (mut memory, mut v) = (loss.memory(), vec![0.0; image.len()]);
    let mut value = |image: &[f32], factor: f32, v: &mut [f32]| {
        let error: Vec<f32> = image.iter().zip(&truth).map(|(a, b)| a - b).collect();
        loss.add(image, &error, factor, &mut memory, v).unwrap()
    };
    value(&image, 2.0, &mut v);
    // Along directions that change many pixels: rectifiers and largest values that change sides average out.
    let mut random = Random::new(3);
    let length = v.iter().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
    assert!(length > 1e-2, "{length}");
    for k in 0..5 {
        let direction: Vec<f32> = v.iter().map(|v| v / length as f32 + 0.1 * random.signed()).collect();
        const STEP: f32 = 1e-3;
        let mut at = |step: f32| {
            let moved: Vec<f32> = image.iter().zip(&direction).map(|(v, d)| v + step * d).collect();
            value(&moved, 0.0, &mut vec![0.0; image.len()])
        };
        let slope = (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP);
        let expected: f64 = v.iter().zip(&direction).map(|(v, d)| f64::from(v * d)).sum::<f64>() / 2.0;
        assert!(
            (slope - expected).abs() < 0.01 * slope.abs().max(expected.abs()),
            "{k}: {expected} is not {slope}"
        );
    }
    // Nothing outside the interior is seen.
    assert!(v[..SIZE[1] * 4 * MARGIN].iter().all(|v| *v == 0.0));
    assert!(v.iter().skip(3).step_by(4).all(|v| *v == 0.0));
}

#[test]
fn other_weights_are_refused() {
    let interior = Interior::new(SIZE[0], SIZE[1], MARGIN).unwrap();
    let refused = |change: &dyn Fn(&mut Arrays)| {
        let mut arrays = weights();
        change(&mut arrays);
        Perceptual::new(&arrays, interior).unwrap_err().to_string()
    };
    let missing = refused(&|arrays| drop(arrays.remove("fire3.conv1x1_2.bias")));
    assert!(missing.contains("fire3.conv1x1_2.bias: expected f32 [64], found none"), "{missing}");
    let other = refused(&|arrays| drop(arrays.insert("conv1.weight".to_owned(), Array::default())));
    assert!(other.contains("conv1.weight: expected f32 [96, 3, 7, 7]"), "{other}");
    let small = Perceptual::new(&weights(), Interior::new(12, 12, 2).unwrap()).unwrap_err().to_string();
    assert!(small.contains("crop: expected images for SqueezeNet, found [8, 8] pixels"), "{small}");
}
