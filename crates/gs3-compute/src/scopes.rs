//! Errors of single calls.

/// The result of `call`, and its first error of the kinds `filters`.
#[cfg(not(target_arch = "wasm32"))]
pub fn caught<T, const N: usize>(
    device: &wgpu::Device,
    filters: [wgpu::ErrorFilter; N],
    call: impl FnOnce() -> T,
) -> (T, Option<wgpu::Error>) {
    let scopes = filters.map(|filter| device.push_error_scope(filter));
    let result = call();
    let mut first = None;
    for scope in scopes.into_iter().rev() {
        // Native drivers have the answer at once.
        if let Some(error) = crate::waiting::at_once(scope.pop()).flatten() {
            first.get_or_insert(error);
        }
    }
    (result, first)
}

/// The result of `call`. A browser answers later, and this call cannot wait: errors come through the callback for
/// uncaught ones.
#[cfg(target_arch = "wasm32")]
pub fn caught<T, const N: usize>(
    _: &wgpu::Device,
    _: [wgpu::ErrorFilter; N],
    call: impl FnOnce() -> T,
) -> (T, Option<wgpu::Error>) {
    (call(), None)
}
