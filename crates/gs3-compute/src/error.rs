//! What can go wrong with a device.

use thiserror::Error;

/// Why a device cannot be had, or did not do its work.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter, or none like that.
    #[error("GPU adapter: expected {expected}, found {actual}")]
    NoAdapter {
        /// Which adapter was asked for.
        expected: String,
        /// The value found.
        actual: String,
    },
    /// The adapter cannot do something that gs3 needs.
    #[error("GPU {adapter}: {what}: expected {expected}, found {actual}")]
    Unsupported {
        /// The adapter's name.
        adapter: String,
        /// A limit or feature.
        what: String,
        /// What is needed.
        expected: String,
        /// What the adapter has.
        actual: String,
    },
    /// A buffer or dispatch is larger than the device takes.
    #[error("GPU, {what}: expected at most {max}, found {actual}")]
    TooLarge {
        /// What is too large.
        what: String,
        /// The device's limit.
        max: u64,
        /// What was asked for.
        actual: u64,
    },
    /// A buffer is shorter than what is to be in it.
    #[error("GPU, {what}: expected at least {min}, found {actual}")]
    TooSmall {
        /// What is too small.
        what: String,
        /// What is needed.
        min: u64,
        /// The value found.
        actual: u64,
    },
    /// The driver ended loops of a kernel early, so that results are wrong.
    #[error(
        "GPU, {what}: expected its loops to run to their end, found them cut short (Mesa's llvmpipe ends them after \
         65535 rounds: too many splats in a tile of pixels for it)"
    )]
    LoopsCut {
        /// What ran.
        what: String,
    },
    /// The device has no more memory.
    #[error("GPU, {what}: expected {bytes} bytes of device memory, found less")]
    OutOfMemory {
        /// What needs the memory.
        what: String,
        /// How much.
        bytes: u64,
    },
    /// The device is gone: driver reset, unplugged, or given back.
    #[error("GPU device lost: {message}")]
    DeviceLost {
        /// What the driver says.
        message: String,
    },
    /// A call would have to wait, which a browser lets no call do.
    #[error("GPU: expected the asynchronous call of the same name, as no call can wait in a browser")]
    WouldBlock,
    /// Something is used on a device that it does not belong to.
    #[error("GPU, {what}: expected that of the device that uses it, found that of another")]
    OtherDevice {
        /// What it is.
        what: &'static str,
    },
    /// A shader that the compiler refuses.
    #[error("shader {label}: {message}")]
    Shader {
        /// Which shader.
        label: String,
        /// What the compiler says.
        message: String,
    },
    /// A kernel got buffers other than those it declares.
    #[error("kernel {kernel}: expected buffers {expected}, found {actual}")]
    Bindings {
        /// The kernel.
        kernel: String,
        /// Names in the shader.
        expected: String,
        /// Names given.
        actual: String,
    },
    /// A call that the device refuses.
    #[error("GPU, {what}: {message}")]
    Refused {
        /// During what.
        what: String,
        /// What the device says.
        message: String,
    },
}
