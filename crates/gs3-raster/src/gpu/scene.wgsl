// What both precisions of the scene share. A page is as many chunks as fit one binding.

struct Page {
    first_chunk: u32,
    chunks: u32,
    gaussians: u32,
    _pad: u32,
}

struct Chunk {
    center: vec3<f32>,
    radius: f32,
    largest_scale: f32,
    _pad: f32,
    _pad2: f32,
    _pad3: f32,
}

struct Shape {
    scales: vec3<f32>,
    opacity: f32,
    // w, x, y, z.
    rotation: vec4<f32>,
}

@group(0) @binding(1) var<uniform> page: Page;
@group(0) @binding(2) var<storage, read> chunks: array<Chunk>;
// Mean and largest scale, world units.
@group(0) @binding(3) var<storage, read> centers: array<vec4<f32>>;

override SH_DEGREE: u32 = 0u;
