// Colour and alpha alone.

fn stage_outputs(slot: u32, splat: u32, room: u32) {}

fn add_outputs(slot: u32, s: Splat, color: vec3<f32>, at: Contribution) {}

fn write_outputs(pixel: Pixel) {}
