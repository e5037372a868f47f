// Exact blocks as samples: what later frames need of them.

// Three vectors for each pixel of the numbered blocks, array after array: colour and median depth, z; ∂colour/∂x and
// ∂colour/∂y per pixel of the picture, and 0.
@group(0) @binding(8) var<storage, read_write> exact_samples: array<vec4<f32>>;

fn stage_outputs(slot: u32, splat: u32, room: u32) {
    stage_plane(slot, splat, room);
}

fn add_outputs(slot: u32, s: Splat, color: vec3<f32>, at: Contribution) {
    add_derivatives(slot, color, at, at.slope * gradient_of(s, at));
}

fn write_outputs(pixel: Pixel) {
    let samples = arrayLength(&exact_samples) / 3u;
    if sample_place < samples {
        let per_pixel = 1.0 / f32(view.scale);
        let depth = median * depth_per_distance(pixel.sample);
        exact_samples[sample_place] = vec4(color_made, depth);
        exact_samples[samples + sample_place] = vec4(dx_over_background() * per_pixel, 0.0);
        exact_samples[2u * samples + sample_place] = vec4(dy_over_background() * per_pixel, 0.0);
    }
}
