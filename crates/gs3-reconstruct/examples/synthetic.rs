#[path = "../tests/common/mod.rs"]
mod common;
use common::*;
use gs3_reconstruct::*;
use gs3_scene::Image;
use std::time::Instant;

fn main() {
    let (w, h) = (960, 540);
    let world = wall_and_post(150.0);
    let speed: f64 = std::env::args().nth(1).map_or(0.02, |s| s.parse().unwrap());
    let mut ss = SuperSampler::new(4).unwrap();
    let mut out = Image::new(w, h);
    let mut hist = Image::new(w, h);
    let mut sums = [0.0; 3];
    let mut itp = Interpolator::new(4).unwrap();
    let mut mid = Image::new(w, h);
    let mut prev: Option<(gs3_scene::Camera, Image, gs3_scene::GBuffer)> = None;
    for k in 0..30 {
        let t = k as f64 * speed;
        let cam = camera(w as u32, h as u32, [t, 0.3 * t, 0.2 * t], 0.1 * t, -0.05 * t);
        let native = world.native(&cam);
        let lr = cam.low_resolution(4);
        let g0 = world.gbuffer(&lr, [0.0, 0.0]);
        resample(&g0, 4, Kernel::Bicubic, &mut out).unwrap();
        let a = psnr(&out, &native);
        hermite(&g0, 4, &mut out).unwrap();
        let b = psnr(&out, &native);
        let g = world.gbuffer(&lr, grid_jitter(4, k));
        let t0 = Instant::now();
        ss.super_sample(&cam, &g, &mut hist).unwrap();
        let ms = t0.elapsed().as_secs_f64() * 1e3;
        let c = psnr(&hist, &native);
        println!("{k}: bicubic {a:.2} hermite {b:.2} history {c:.2}  {ms:.1} ms");
        if let Some((pc, pi, pg)) = &prev {
            let t = (k as f64 - 0.5) * speed;
            let mc = camera(w as u32, h as u32, [t, 0.3 * t, 0.2 * t], 0.1 * t, -0.05 * t);
            let t0 = Instant::now();
            itp.interpolate(
                Neighbor { camera: pc, image: pi, gbuffer: pg },
                Neighbor { camera: &cam, image: &hist, gbuffer: &g },
                0.5,
                &mc,
                &mut mid,
            )
            .unwrap();
            let ms = t0.elapsed().as_secs_f64() * 1e3;
            println!("    middle {:.2}  {ms:.1} ms", psnr(&mid, &world.native(&mc)));
        }
        prev = Some((cam, hist.clone(), g));
        sums[0] += a;
        sums[1] += b;
        sums[2] += c;
    }
    println!("mean {:?}", sums.map(|s| s / 30.0));
}
