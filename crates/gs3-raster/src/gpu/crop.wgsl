// The picture out of a plane with a margin around it. An invocation a pixel.

// Beside CropUniform in crop.rs, layouts compared by a test.
struct Crop {
    // Of the picture.
    size: vec2<u32>,
    // Columns and rows before it.
    first: vec2<u32>,
    // From a row of the plane to the next.
    stride: u32,
    _pad: u32,
}

@group(0) @binding(0) var<uniform> crop: Crop;
@group(0) @binding(1) var<storage, read> padded: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> picture: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn copy_picture(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= crop.size) {
        return;
    }
    let place = at.xy + crop.first;
    picture[at.y * crop.size.x + at.x] = padded[place.y * crop.stride + place.x];
}
