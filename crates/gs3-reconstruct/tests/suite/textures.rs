//! Frames of a device as textures.

use crate::gpu::gpu;
use gs3_compute::{Use, wgpu};
use gs3_reconstruct::gpu::GpuImage;

/// Rows of textures begin at multiples of 256 bytes. A row of 32 pixels is one, a row of 37 is not.
#[test]
fn images_become_textures() {
    let Some(gpu) = gpu() else { return };
    let texture = |[width, height]: [u32; 2], format, usage| {
        gpu.device().create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    };
    let (half, both) =
        (wgpu::TextureFormat::Rgba16Float, wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC);
    for size in [[32, 3], [37, 5]] {
        let image = GpuImage::new(&gpu, size.into()).unwrap();
        let pixels: Vec<u8> = (0..image.bytes()).map(|k| (k % 249) as u8).collect();
        gpu.write(&image.pixels().slice(), &pixels).unwrap();
        let whole = texture(size, half, both);
        // Again, with the memory of the first time.
        for _ in 0..2 {
            let mut recorder = gpu.recorder(None);
            image.copy_to_texture(&gpu, &mut recorder, &whole).unwrap();
            recorder.submit().unwrap();
        }
        let (row, apart) = (size[0] as usize * 8, (size[0] as usize * 8).next_multiple_of(256));
        let back = gpu.buffer("back", Use::Storage, (apart * size[1] as usize) as u64).unwrap();
        let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(apart as u32),
            rows_per_image: None,
        };
        encoder.copy_texture_to_buffer(
            whole.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: back.raw(), layout },
            whole.size(),
        );
        gpu.queue().submit([encoder.finish()]);
        let found = gpu.read::<u8>(&back.slice()).unwrap();
        for (y, expected) in pixels.chunks_exact(row).enumerate() {
            assert_eq!(&found[y * apart..][..row], expected, "{size:?}, row {y}");
        }
        let wider = format!("expected ({0}, {1}, 1), found ({2}, {1}, 1)", size[0], size[1], size[0] + 1);
        for (wrong, expected) in [
            (texture([size[0] + 1, size[1]], half, both), wider.as_str()),
            (texture(size, wgpu::TextureFormat::Rgba8Unorm, both), "expected Rgba16Float, found Rgba8Unorm"),
            (texture(size, half, wgpu::TextureUsages::COPY_SRC), "expected usage COPY_DST"),
        ] {
            let mut recorder = gpu.recorder(None);
            let error = image.copy_to_texture(&gpu, &mut recorder, &wrong).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
