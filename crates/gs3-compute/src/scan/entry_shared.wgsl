@compute @workgroup_size(THREADS)
fn sum(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3<u32>) {
    sum_block(Thread(index, 0u, 0u, 0u), group.x);
}

@compute @workgroup_size(THREADS)
fn scan(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3<u32>) {
    scan_block(Thread(index, 0u, 0u, 0u), group.x);
}
