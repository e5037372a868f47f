// Depth and normal of a Gaussian as seen by the camera (RaDe-GS, Zhang et al. 2024); see geometry.rs.

struct Geometry {
    ray_distance: f32,
    ray_plane: vec2<f32>,
    normal: vec3<f32>,
}

fn geometry_of(mean: vec3<f32>, axes: mat3x3<f32>, scales: vec3<f32>) -> Geometry {
    let inv_z = 1.0 / mean.z;
    let ray = vec3(mean.x * inv_z, mean.y * inv_z, 1.0);
    let smallest = min(min(scales.x, scales.y), scales.z);
    var m = vec3(0.0);
    for (var k = 0u; k < 3u; k++) {
        let axis = rotate(axes[k]);
        // 0/0 of a degenerate axis counts as the smallest itself.
        let ratio = select(1.0, smallest / scales[k], scales[k] > smallest);
        m = fma(vec3(ratio * ratio * dot3(axis, ray)), axis, m);
    }
    let ray_length2 = dot3(ray, ray);
    let inv_ray_length2 = 1.0 / ray_length2;
    // An edge-on flat Gaussian has no plane of maxima; its centre's depth is used.
    let along = dot3(m, ray);
    let distance = mean.z * sqrt(ray_length2);
    var plane = vec2(0.0);
    if along > TINY {
        let slopes = distance * (m.xy / along - ray.xy * inv_ray_length2) * (1.0 / view.focal);
        // So steep a plane is edge-on too; times a pixel distance it would overflow.
        plane = select(vec2(0.0), slopes, abs(slopes) < vec2(STEEPEST_PLANE));
    }
    let length2 = dot3(m, m);
    var normal = -ray * sqrt(inv_ray_length2);
    if length2 > TINY {
        normal = -m * (1.0 / sqrt(length2));
    }
    return Geometry(distance, plane, normal);
}
