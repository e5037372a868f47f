// The image alone.

fn add_past(k: u32, is_past: bool, weighed: vec4<f32>) {}

fn write_innovation(k: u32, at: vec2<u32>, tile_varies: bool) {}

fn begin_errors(lane: u32) {}

fn add_error(at: vec2<u32>, corner: vec2<i32>, correction: vec3<f32>) {}

fn write_errors(corner: vec2<i32>, lane: u32) {}
