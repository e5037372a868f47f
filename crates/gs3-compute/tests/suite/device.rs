//! A device does what it is told, and says what goes wrong.

use crate::common::devices;
use gs3_compute::*;

const DOUBLE: &str = "
    override FACTOR: u32 = 1u;
    @group(0) @binding(0) var<uniform> offset: vec4<u32>;
    @group(0) @binding(1) var<storage> source: array<u32>;
    @group(0) @binding(2) var<storage, read_write> result: array<u32>;
    @group(0) @binding(3) var<storage, read_write> unused: array<u32>;
    @compute @workgroup_size(64)
    fn scale(@builtin(global_invocation_id) id: vec3<u32>) {
        if id.x < arrayLength(&source) {
            result[id.x] = FACTOR * source[id.x] + offset.x;
        }
    }
    @compute @workgroup_size(1)
    fn counts() {
        unused[0] = 1u;
        unused[1] = 1u;
        unused[2] = 1u;
    }";

#[test]
fn kernels_run_in_the_order_recorded_and_are_timed() {
    for gpu in devices() {
        let module = gpu.module("double", &[DOUBLE]).unwrap();
        let scale = module.kernel(&gpu, "scale", &[("FACTOR", 3.0)]).unwrap();
        let counts = module.kernel(&gpu, "counts", &[]).unwrap();
        let values: Vec<u32> = (0..64).collect();
        let a = gpu.buffer_with("a", Use::Storage, &values).unwrap();
        let b = gpu.buffer("b", Use::Storage, 256).unwrap();
        let indirect = gpu.buffer("indirect", Use::Indirect, 12).unwrap();
        let offset = gpu.buffer_with("offset", Use::Uniform, &[7u32, 0, 0, 0]).unwrap();
        let forth = [("offset", (&offset).into()), ("source", (&a).into()), ("result", (&b).into())];
        let back = [("offset", (&offset).into()), ("source", (&b).into()), ("result", (&a).into())];
        let (forth, back) = (scale.bind(&gpu, &forth).unwrap(), scale.bind(&gpu, &back).unwrap());
        let counts = counts.bind(&gpu, &[("unused", (&indirect).into())]).unwrap();
        let mut timings = Timings::new(&gpu).ok();
        let mut recorder = gpu.recorder(timings.as_mut());
        recorder.stage("forth");
        recorder.dispatch(&forth, [1, 1, 1]);
        recorder.clear(&a.part(0, 128));
        recorder.stage("back");
        recorder.dispatch(&counts, [1, 1, 1]);
        recorder.dispatch_indirect(&back, &indirect, 0);
        recorder.copy(&a.part(0, 4), &b.part(8, 4));
        let submission = recorder.submit().unwrap();
        gpu.wait(&submission).unwrap();
        let expected: Vec<u32> = values.iter().map(|v| 3 * (3 * v + 7) + 7).collect();
        assert_eq!(gpu.read::<u32>(&a.slice()).unwrap(), expected);
        assert_eq!(gpu.read::<u32>(&b.part(8, 4)).unwrap(), expected[..1]);
        if let Some(timings) = timings {
            let times = timings.read(&gpu, &submission).unwrap();
            assert_eq!(times.iter().map(|t| t.stage).collect::<Vec<_>>(), ["forth", "back"]);
            assert!(times.iter().all(|t| t.time.as_secs() < 60), "{times:?}");
        }
    }
}

/// Whenever it is recorded, and in each frame anew.
#[test]
fn what_a_frame_writes_is_there_before_its_kernels_run() {
    for gpu in devices() {
        let kernel = gpu.module("double", &[DOUBLE]).unwrap().kernel(&gpu, "scale", &[]).unwrap();
        let source = gpu.buffer_with("source", Use::Storage, &[10u32; 4]).unwrap();
        let result = gpu.buffer("result", Use::Storage, 16).unwrap();
        let offset = gpu.buffer("offset", Use::Uniform, 16).unwrap();
        let buffers =
            [("offset", (&offset).into()), ("source", (&source).into()), ("result", (&result).into())];
        let bound = kernel.bind(&gpu, &buffers).unwrap();
        for frame in 1..20u32 {
            let mut recorder = gpu.recorder(None);
            recorder.dispatch(&bound, [1, 1, 1]);
            recorder.write(&offset.slice(), &[frame, 0, 0, 0]).unwrap();
            recorder.write(&source.part(12, 4), &[frame]).unwrap();
            // What is recorded and dropped leaves no trace.
            gpu.recorder(None).write(&offset.slice(), &[1000u32]).unwrap();
            let submission = recorder.submit().unwrap();
            if frame % 3 == 0 {
                gpu.wait(&submission).unwrap();
            }
            assert_eq!(
                gpu.read::<u32>(&result.slice()).unwrap(),
                [10 + frame, 10 + frame, 10 + frame, 2 * frame]
            );
        }
        let error = gpu.recorder(None).write(&offset.slice(), &[0u32; 5]).unwrap_err();
        assert!(matches!(error, GpuError::TooLarge { max: 16, actual: 20, .. }), "{error}");
    }
}

/// A fill between kernels counts to the stage that wanted it, not to none.
#[test]
fn fills_between_kernels_are_timed() {
    for gpu in devices() {
        let Ok(mut timings) = Timings::new(&gpu) else { continue };
        let counts = gpu.module("double", &[DOUBLE]).unwrap().kernel(&gpu, "counts", &[]).unwrap();
        let small = gpu.buffer("small", Use::Storage, 12).unwrap();
        let large = gpu.buffer("large", Use::Storage, 128 << 20).unwrap();
        let kernel = counts.bind(&gpu, &[("unused", (&small).into())]).unwrap();
        // The least of some runs of both stages.
        let mut least = |filled: u64| {
            let times = (0..5).map(|_| {
                let mut recorder = gpu.recorder(Some(&mut timings));
                recorder.stage("first");
                recorder.dispatch(&kernel, [1, 1, 1]);
                recorder.clear(&large.part(0, filled));
                recorder.stage("second");
                recorder.dispatch(&kernel, [1, 1, 1]);
                let submission = recorder.submit().unwrap();
                let times = timings.read(&gpu, &submission).unwrap();
                assert_eq!(times.iter().map(|t| t.stage).collect::<Vec<_>>(), ["first", "second"]);
                [times[0].time, times[1].time]
            });
            times.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1])]).unwrap()
        };
        let (without, with) = (least(4), least(128 << 20));
        assert!(with[0] > 2 * without[0], "{without:?} {with:?}");
        assert!(with[1] < with[0], "{without:?} {with:?}");
    }
}

#[test]
fn mistakes_are_typed_errors() {
    for gpu in devices() {
        let error = gpu.module("broken", &["fn f() -> u32 { return 1.0; }"]).unwrap_err();
        assert!(matches!(error, GpuError::Shader { label, .. } if label == "broken"));
        let module = gpu.module("double", &[DOUBLE]).unwrap();
        assert!(matches!(module.kernel(&gpu, "scael", &[]), Err(GpuError::Shader { .. })));
        assert!(matches!(module.kernel(&gpu, "scale", &[("NONE", 1.0)]), Err(GpuError::Shader { .. })));
        let kernel = module.kernel(&gpu, "scale", &[]).unwrap();
        let error = kernel.bind(&gpu, &[]).unwrap_err();
        assert!(matches!(error, GpuError::Bindings { expected, .. } if expected == "offset, source, result"));
        let max = gpu.capabilities().limits.buffer_bytes;
        let error = gpu.buffer("huge", Use::Storage, max + 1).unwrap_err();
        assert!(matches!(error, GpuError::TooLarge { actual, .. } if actual == max + 1));
        let buffer = gpu.buffer("small", Use::Storage, 16).unwrap();
        assert!(matches!(gpu.write(&buffer.slice(), &[0u32; 5]), Err(GpuError::TooLarge { .. })));
        // One buffer read and written at once: the device refuses the frame, and goes on.
        let offset = gpu.buffer("offset", Use::Uniform, 16).unwrap();
        let slices =
            [("offset", (&offset).into()), ("source", (&buffer).into()), ("result", (&buffer).into())];
        let bound = kernel.bind(&gpu, &slices).unwrap();
        let mut recorder = gpu.recorder(None);
        recorder.dispatch(&bound, [1, 1, 1]);
        assert!(matches!(recorder.submit(), Err(GpuError::Refused { .. })));
        gpu.check().unwrap();
        assert_eq!(gpu.read::<u32>(&buffer.slice()).unwrap(), [0; 4]);
    }
}

#[test]
fn a_lost_device_says_so() {
    for gpu in devices() {
        let module = gpu.module("double", &[DOUBLE]).unwrap();
        let buffer = gpu.buffer_with("a", Use::Storage, &[1u32; 4]).unwrap();
        let (recorder, mut writer) = (gpu.recorder(None), gpu.recorder(None));
        gpu.destroy();
        let lost = |error: GpuError| matches!(error, GpuError::DeviceLost { .. });
        assert!(lost(writer.write(&buffer.slice(), &[1u32]).unwrap_err()));
        assert!(lost(recorder.submit().unwrap_err()));
        assert!(lost(gpu.check().unwrap_err()));
        assert!(lost(gpu.buffer("b", Use::Storage, 4).unwrap_err()));
        assert!(lost(gpu.write(&buffer.slice(), &[1u32]).unwrap_err()));
        assert!(lost(gpu.read::<u32>(&buffer.slice()).unwrap_err()));
        assert!(lost(module.kernel(&gpu, "scale", &[]).unwrap_err()));
    }
}

#[test]
fn arenas_grow_and_say_so() {
    for gpu in devices() {
        let mut arena = Arena::default();
        let need = |bytes| [Need { name: "splats", usage: Use::Storage, bytes }];
        assert_eq!(arena.fit(&gpu, &need(100)).unwrap(), Fit::Grown);
        assert_eq!(arena.fit(&gpu, &need(50)).unwrap(), Fit::Kept);
        assert_eq!(arena.fit(&gpu, &need(1000)).unwrap(), Fit::Grown);
        // What grew once has a reserve.
        assert_eq!(arena.fit(&gpu, &need(1200)).unwrap(), Fit::Kept);
        assert!(arena.get("splats").unwrap().bytes() >= 1200);
        assert!(arena.get("else").is_none());
        assert!(arena.fit(&gpu, &need(u64::MAX / 2)).is_err());
    }
}

/// More than is sent at once arrives in order.
#[test]
fn long_uploads_arrive() {
    for gpu in devices().into_iter().take(1) {
        let values: Vec<u32> = (0..(70 << 20) / 4).collect();
        let buffer = gpu.buffer_with("long", Use::Storage, &values).unwrap();
        for start in [0, (64 << 20) - 8, (70 << 20) - 16] {
            let first = start as u32 / 4;
            assert_eq!(gpu.read::<u32>(&buffer.part(start, 16)).unwrap(), [0, 1, 2, 3].map(|k| first + k));
        }
        let bytes = gpu.buffer_with("bytes", Use::Storage, &[1u8, 2, 3, 4, 5]).unwrap();
        assert_eq!(gpu.read::<u8>(&bytes.part(0, 8)).unwrap(), [1, 2, 3, 4, 5, 0, 0, 0]);
    }
}

/// What wgpu calls experimental is there for those who ask for it.
#[test]
fn experimental_features_are_asked_for() {
    let open = |features| device_for_tests(&GpuSettings { features, ..GpuSettings::default() });
    let (Some(plain), Some(asked)) = (open(OptionalFeatures::All), open(OptionalFeatures::Experimental))
    else {
        return;
    };
    assert_eq!(plain.capabilities().cooperative_matrix, Vec::<[u32; 3]>::new());
    let has = &asked.adapter().capabilities.cooperative_matrix;
    assert_eq!(&asked.capabilities().cooperative_matrix, has);
    let module = "enable f16; enable wgpu_cooperative_matrix;
        @group(0) @binding(0) var<storage, read_write> sums: array<f32>;
        @compute @workgroup_size(64)
        fn zeros() { coopStoreT(coop_mat8x8<f32, C>(), &sums[0], 8u); }";
    let compiled = |gpu: &Gpu| {
        let kernel = gpu.module("zeros", &[module]).and_then(|module| module.kernel(gpu, "zeros", &[]));
        kernel.map(|_| ())
    };
    assert!(compiled(&plain).is_err(), "a device without them compiles them");
    if has.contains(&[8; 3]) {
        compiled(&asked).unwrap();
    }
}

#[test]
fn adapters_are_chosen_by_kind() {
    let limits =
        Limits { buffer_bytes: 1 << 30, binding_bytes: 1 << 30, workgroup_bytes: 1 << 15, ..Limits::LEAST };
    let adapter = |name: &str, kind, api, missing| AdapterReport {
        name: name.to_owned(),
        api,
        kind,
        driver: String::new(),
        capabilities: Capabilities {
            subgroups: Subgroups::Absent,
            shader_f16: false,
            timestamps: false,
            cooperative_matrix: Vec::new(),
            limits,
        },
        missing,
    };
    let lacking = GpuError::NoAdapter { expected: "x".to_owned(), actual: "y".to_owned() };
    let all = [
        adapter("cpu", AdapterKind::Software, Api::Vulkan, None),
        adapter("old", AdapterKind::Discrete, Api::Dx12, Some(lacking.clone())),
        adapter("small", AdapterKind::Integrated, Api::Vulkan, None),
        adapter("card", AdapterKind::Discrete, Api::Vulkan, None),
        adapter("card 2", AdapterKind::Discrete, Api::Vulkan, None),
    ];
    assert_eq!(choose(&all, AdapterChoice::Auto).unwrap().0, 3);
    assert_eq!(choose(&all[..3], AdapterChoice::Auto).unwrap().0, 2);
    assert!(choose(&all[..1], AdapterChoice::Auto).unwrap().1.contains("software"));
    assert_eq!(choose(&all, AdapterChoice::Fast).unwrap().0, 3);
    assert!(matches!(choose(&all[..1], AdapterChoice::Fast), Err(GpuError::NoAdapter { .. })));
    assert_eq!(choose(&all, AdapterChoice::Number(0)).unwrap().0, 0);
    assert_eq!(choose(&all, AdapterChoice::Number(1)).unwrap_err(), lacking);
    assert_eq!(choose(&all, AdapterChoice::Api(Api::Dx12)).unwrap_err(), lacking);
    let none = |choice| matches!(choose(&all, choice), Err(GpuError::NoAdapter { .. }));
    assert!(none(AdapterChoice::Number(5)) && none(AdapterChoice::Api(Api::Metal)));
    assert!(
        matches!(choose(&[], AdapterChoice::Auto), Err(GpuError::NoAdapter { actual, .. }) if actual == "none")
    );
}

#[test]
fn data_beyond_one_binding_is_divided() {
    let limits = Limits { buffer_bytes: 1 << 40, workgroup_bytes: 1 << 15, ..Limits::LEAST };
    let plan = ChunkPlan::new(&limits, 50_000_000, 96, 256).unwrap();
    assert_eq!(plan.per_chunk % 256, 0);
    assert!(plan.per_chunk * 96 <= 128 << 20 && (plan.per_chunk + 256) * 96 > 128 << 20);
    let mut next = 0;
    for range in plan.ranges() {
        assert_eq!(range.start, next);
        next = range.end;
    }
    assert_eq!(next, 50_000_000);
    assert_eq!(ChunkPlan::new(&limits, 0, 4, 1).unwrap().ranges().collect::<Vec<_>>(), vec![0..0]);
    assert!(matches!(ChunkPlan::new(&limits, 1, 1 << 20, 256), Err(GpuError::TooLarge { .. })));
}

/// wgpu would take it for something of the device's own, or panic.
#[test]
fn what_belongs_to_another_device_is_refused() {
    let open = || device_for_tests(&GpuSettings::default());
    let (Some(gpu), Some(other)) = (open(), open()) else { return };
    let refused = |result: Result<(), GpuError>| {
        let error = result.unwrap_err();
        assert!(matches!(error, GpuError::OtherDevice { .. }), "{error}");
    };
    let kernel_of = |gpu: &Gpu| gpu.module("double", &[DOUBLE]).unwrap().kernel(gpu, "counts", &[]).unwrap();
    let buffer_of = |gpu: &Gpu| gpu.buffer("b", Use::Indirect, 16).unwrap();
    let [own, strange] = [&gpu, &other].map(buffer_of);
    refused(gpu.read::<u32>(&strange.slice()).map(drop));
    refused(gpu.write(&strange.slice(), &[1u32]));
    refused(gpu.module("double", &[DOUBLE]).unwrap().kernel(&other, "counts", &[]).map(drop));
    refused(kernel_of(&gpu).bind(&gpu, &[("unused", strange.slice())]).map(drop));
    refused(kernel_of(&other).bind(&gpu, &[("unused", own.slice())]).map(drop));
    let bound = kernel_of(&other).bind(&other, &[("unused", strange.slice())]).unwrap();
    let own_bound = kernel_of(&gpu).bind(&gpu, &[("unused", own.slice())]).unwrap();
    let readback = Readback::new(&other, 16).unwrap();
    let records: [&dyn Fn(&mut Recorder<'_>); 7] = [
        &|r| r.dispatch(&bound, [1; 3]),
        &|r| r.dispatch_indirect(&bound, &own, 0),
        &|r| r.dispatch_indirect(&own_bound, &strange, 0),
        &|r| r.copy(&strange.slice(), &own.slice()),
        &|r| r.copy(&own.slice(), &strange.slice()),
        &|r| r.read_back(&own.slice(), &readback, 0),
        &|r| r.clear(&strange.slice()),
    ];
    for record in records {
        let mut recorder = gpu.recorder(None);
        record(&mut recorder);
        refused(recorder.submit().map(drop));
    }
    refused(gpu.recorder(None).write(&strange.slice(), &[1u32]));
    if let Ok(mut timings) = Timings::new(&other) {
        refused(gpu.recorder(Some(&mut timings)).submit().map(drop));
    }
    let submission = other.recorder(None).submit().unwrap();
    refused(gpu.wait(&submission));
    refused(now(readback.read(&gpu, &submission, |_| ())));
    // Neither is any the worse for it.
    let mut recorder = gpu.recorder(None);
    recorder.dispatch(&own_bound, [1; 3]);
    recorder.submit().unwrap();
    assert_eq!(gpu.read::<u32>(&own.part(0, 12)).unwrap(), [1; 3]);
    assert_eq!((gpu.check(), other.check()), (Ok(()), Ok(())));
}

/// A program's own device: gs3 reads and writes buffers of its making, in the order of its own submissions.
#[test]
fn a_device_may_be_the_callers_own() {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all())).into_iter().next();
    let Some(adapter) = adapter else {
        return skip_without_gpu("the instance lists none");
    };
    let open = |descriptor| pollster::block_on(adapter.request_device(&descriptor)).unwrap();
    // As a program opens it that knows nothing of gs3: the limits of WebGPU, and no features.
    let plain = open(wgpu::DeviceDescriptor::default());
    let wanted = open(Gpu::wanted(&adapter, OptionalFeatures::All));
    for (k, (device, queue)) in [plain, wanted].into_iter().enumerate() {
        let gpu = Gpu::of(&adapter, device.clone(), queue.clone()).unwrap();
        let Capabilities { shader_f16, timestamps, limits, .. } = gpu.capabilities().clone();
        let on_adapter = adapter.features().contains(wgpu::Features::SHADER_F16);
        assert_eq!(shader_f16, k == 1 && on_adapter);
        assert_eq!(limits.binding_bytes, device.limits().max_storage_buffer_binding_size);
        assert!(k == 1 || !timestamps);
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let made = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size: 64,
                usage,
                mapped_at_creation: false,
            })
        };
        let (theirs, unusable) = (made(usage), made(wgpu::BufferUsages::STORAGE));
        assert!(matches!(Buffer::of(&gpu, unusable), Err(GpuError::Refused { .. })));
        let source = Buffer::of(&gpu, theirs.clone()).unwrap();
        queue.write_buffer(&theirs, 0, bytemuck::cast_slice(&[5u32; 16]));
        let result = gpu.buffer("result", Use::Storage, 64).unwrap();
        let offset = gpu.buffer_with("offset", Use::Uniform, &[7u32, 0, 0, 0]).unwrap();
        let buffers =
            [("offset", (&offset).into()), ("source", (&source).into()), ("result", (&result).into())];
        let kernel =
            gpu.module("double", &[DOUBLE]).unwrap().kernel(&gpu, "scale", &[("FACTOR", 3.0)]).unwrap();
        let mut recorder = gpu.recorder(None);
        recorder.dispatch(&kernel.bind(&gpu, &buffers).unwrap(), [1; 3]);
        recorder.submit().unwrap();
        // The program takes it from there, without a way through the processor.
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(result.raw(), 0, &theirs, 0, 64);
        queue.submit([encoder.finish()]);
        assert_eq!(gpu.read::<u32>(&source.slice()).unwrap(), [22; 16]);
        device.destroy();
        let lost = gpu.read::<u32>(&source.slice()).unwrap_err();
        assert!(matches!(lost, GpuError::DeviceLost { .. }), "{lost}");
    }
}
