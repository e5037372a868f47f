//! Scan and sort do what the standard library does.

use crate::common::{Random, devices};
use gs3_compute::{Gpu, Pairs, Scan, Sort, Use};

/// Around the sizes of workgroups, tiles and blocks, and some larger ones.
const SIZES: [usize; 16] =
    [0, 1, 2, 31, 255, 256, 257, 1023, 1025, 2047, 2048, 2049, 4097, 10_007, 65_536, 300_001];

#[test]
fn scans_sum_what_is_before() {
    for gpu in devices() {
        let scan = Scan::new(&gpu).unwrap();
        for size in SIZES.into_iter().chain([1_100_003]) {
            let mut random = Random::new(size as u64);
            // Large ones, so that sums wrap.
            let values: Vec<u32> = (0..size + 3).map(|_| random.next() >> 8).collect();
            let count = gpu.buffer_with("count", Use::Storage, &[size as u32]).unwrap();
            let buffer = gpu.buffer_with("values", Use::Storage, &values).unwrap();
            let total = gpu.buffer_with("total", Use::Storage, &[7u32]).unwrap();
            let bound = scan.bind(&gpu, count.slice(), buffer.slice(), total.slice()).unwrap();
            let mut recorder = gpu.recorder(None);
            bound.record(&mut recorder);
            recorder.submit().unwrap();
            let mut sum = 0u32;
            let mut expected = Vec::with_capacity(values.len());
            for value in &values[..size] {
                expected.push(sum);
                sum = sum.wrapping_add(*value);
            }
            // What is behind the count stays.
            expected.extend(&values[size..]);
            assert!(gpu.read::<u32>(&buffer.slice()).unwrap()[..size + 3] == expected, "{size}");
            assert_eq!(gpu.read::<u32>(&total.part(0, 4)).unwrap(), [sum], "{size}");
        }
    }
}

/// Sorts `keys` with their places as values.
fn sorted(gpu: &Gpu, sort: &Sort, keys: &[u32]) -> Vec<(u32, u32)> {
    let capacity = u64::from(sort.plan().capacity) * 4;
    let count = gpu.buffer_with("count", Use::Storage, &[keys.len() as u32]).unwrap();
    let places: Vec<u32> = (0..keys.len() as u32).collect();
    let [a, b, c, d] = ["a", "b", "c", "d"].map(|label| gpu.buffer(label, Use::Storage, capacity).unwrap());
    gpu.write(&a.slice(), keys).unwrap();
    gpu.write(&b.slice(), &places).unwrap();
    let pairs = [(&a, &b), (&c, &d)].map(|(keys, values)| Pairs { keys: keys.into(), values: values.into() });
    let bound = sort.bind(gpu, count.slice(), pairs).unwrap();
    let mut recorder = gpu.recorder(None);
    bound.record(&mut recorder);
    recorder.submit().unwrap();
    let result = pairs[sort.plan().result()];
    let [keys_out, values_out] = [result.keys, result.values].map(|slice| gpu.read::<u32>(&slice).unwrap());
    keys_out.into_iter().zip(values_out).take(keys.len()).collect()
}

/// The same by the standard library.
fn expected(keys: &[u32], bits: u32) -> Vec<(u32, u32)> {
    let mut pairs: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
    let mask = ((1u64 << bits) - 1) as u32;
    pairs.sort_by_key(|(key, _)| key & mask);
    pairs
}

#[test]
fn sorts_are_stable_and_right() {
    for gpu in devices() {
        for bits in [32, 13] {
            let sort = Sort::new(&gpu, 300_001, bits).unwrap();
            for size in SIZES {
                let mut random = Random::new(size as u64);
                let keys: Vec<u32> = (0..size).map(|_| random.next()).collect();
                assert!(sorted(&gpu, &sort, &keys) == expected(&keys, bits), "{size} pairs, {bits} bits");
            }
        }
        for bits in [1, 8, 20] {
            let sort = Sort::new(&gpu, 5_000, bits).unwrap();
            let mut random = Random::new(9);
            // Few different keys: order among equal ones is all.
            for keys in [
                (0..5_000).map(|_| random.next() % 3).collect::<Vec<u32>>(),
                vec![u32::MAX; 4_999],
                vec![0; 4_321],
                (0..5_000).rev().collect(),
            ] {
                assert!(sorted(&gpu, &sort, &keys) == expected(&keys, bits), "{bits} bits, {:?}", &keys[..4]);
            }
        }
    }
}

/// Of more pairs and of fewer, by as many bits and by others.
#[test]
fn sorts_of_other_sizes_are_right() {
    for gpu in devices() {
        let first = Sort::new(&gpu, 5_000, 13).unwrap();
        let mut random = Random::new(3);
        for (capacity, bits) in [(70_001, 13), (700, 13), (9_000, 20)] {
            let sort = first.resized(&gpu, capacity, bits).unwrap();
            let keys: Vec<u32> = (0..capacity).map(|_| random.next()).collect();
            assert!(sorted(&gpu, &sort, &keys) == expected(&keys, bits), "{capacity} pairs, {bits} bits");
        }
    }
}

/// No tile depends on another one being fast.
#[test]
fn sorts_without_waiting_are_right() {
    for gpu in devices() {
        let sort = Sort::impatient(&gpu, 100_003, 32).unwrap();
        let mut random = Random::new(1);
        let keys: Vec<u32> = (0..100_003).map(|_| random.next()).collect();
        assert!(sorted(&gpu, &sort, &keys) == expected(&keys, 32));
    }
}

/// A count beyond the capacity is cut, not followed.
#[test]
fn counts_beyond_the_capacity_are_cut() {
    for gpu in devices() {
        let sort = Sort::new(&gpu, 100, 8).unwrap();
        let count = gpu.buffer_with("count", Use::Storage, &[u32::MAX]).unwrap();
        let keys: Vec<u32> = (0..200).rev().collect();
        let buffers = [0; 4].map(|_| gpu.buffer_with("pairs", Use::Storage, &keys).unwrap());
        let [a, b, c, d] = &buffers;
        let pairs = [(a, b), (c, d)].map(|(keys, values)| Pairs { keys: keys.into(), values: values.into() });
        let bound = sort.bind(&gpu, count.slice(), pairs).unwrap();
        let mut recorder = gpu.recorder(None);
        bound.record(&mut recorder);
        recorder.submit().unwrap();
        let result = gpu.read::<u32>(&pairs[sort.plan().result()].keys).unwrap();
        assert!(result[..100].iter().copied().eq(100..200) && result[100..200] == keys[100..]);
    }
}
