// Without the innovation.

fn add_past(k: u32, is_past: bool, weighed: vec4<f32>) {}

fn write_innovation(k: u32, at: vec2<u32>, tile_varies: bool) {}
