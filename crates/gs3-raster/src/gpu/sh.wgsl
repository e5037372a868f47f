// View-dependent colour from spherical harmonics; see sh.rs.

// Display-encoded RGB of Gaussian i seen along `direction` (any length), at least 0.
fn color_of(i: u32, direction: vec3<f32>) -> vec3<f32> {
    var color = fma(vec3(C0), sh_of(i, 0u), vec3(0.5));
    if SH_DEGREE > 0u {
        let d = direction * (1.0 / sqrt(dot3(direction, direction)));
        let x = d.x;
        let y = d.y;
        let z = d.z;
        color += (-C1 * y) * sh_of(i, 1u) + (C1 * z) * sh_of(i, 2u) + (-C1 * x) * sh_of(i, 3u);
        if SH_DEGREE > 1u {
            let xx = x * x;
            let yy = y * y;
            let zz = z * z;
            color += (C2_0 * x * y) * sh_of(i, 4u);
            color += (C2_1 * y * z) * sh_of(i, 5u);
            color += (C2_2 * (2.0 * zz - xx - yy)) * sh_of(i, 6u);
            color += (C2_3 * x * z) * sh_of(i, 7u);
            color += (C2_4 * (xx - yy)) * sh_of(i, 8u);
            if SH_DEGREE > 2u {
                color += (C3_0 * y * (3.0 * xx - yy)) * sh_of(i, 9u);
                color += (C3_1 * x * y * z) * sh_of(i, 10u);
                color += (C3_2 * y * (4.0 * zz - xx - yy)) * sh_of(i, 11u);
                color += (C3_3 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)) * sh_of(i, 12u);
                color += (C3_4 * x * (4.0 * zz - xx - yy)) * sh_of(i, 13u);
                color += (C3_5 * z * (xx - yy)) * sh_of(i, 14u);
                color += (C3_6 * x * (xx - 3.0 * yy)) * sh_of(i, 15u);
                if SH_DEGREE > 3u {
                    color += (C4_0 * x * y * (xx - yy)) * sh_of(i, 16u);
                    color += (C4_1 * y * z * (3.0 * xx - yy)) * sh_of(i, 17u);
                    color += (C4_2 * x * y * (7.0 * zz - 1.0)) * sh_of(i, 18u);
                    color += (C4_3 * y * z * (7.0 * zz - 3.0)) * sh_of(i, 19u);
                    color += (C4_4 * (zz * (35.0 * zz - 30.0) + 3.0)) * sh_of(i, 20u);
                    color += (C4_5 * x * z * (7.0 * zz - 3.0)) * sh_of(i, 21u);
                    color += (C4_6 * (xx - yy) * (7.0 * zz - 1.0)) * sh_of(i, 22u);
                    color += (C4_7 * x * z * (xx - 3.0 * yy)) * sh_of(i, 23u);
                    color += (C4_8 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy))) * sh_of(i, 24u);
                }
            }
        }
    }
    return max(color, vec3(0.0));
}
