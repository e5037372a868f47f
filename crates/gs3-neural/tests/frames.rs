//! What many frames need: no memory, and the same bits on any number of threads.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use gs3_neural::model::{Tier, initial_weights, interpolate};
use gs3_neural::{Engine, Header, Random};

/// Counts what it gives out.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);

#[allow(unsafe_code)]
// SAFETY: everything is the system allocator's; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller has the same obligations as with the system allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System.alloc` with this layout.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn frames_take_no_memory_and_are_the_same_on_any_number_of_threads() {
    let (graph, lr) = (interpolate(4, Tier::Balanced).expect("a network"), [24, 40]);
    let mut engine =
        Engine::new(&graph, &initial_weights(&graph, Header::of(&graph, 4), 2), lr).expect("an engine");
    let (mut random, shapes) = (Random::new(1), graph.shapes(lr).expect("a size"));
    let images: Vec<(&str, Vec<f32>)> = graph
        .inputs()
        .map(|(t, l)| (l.name.as_str(), (0..shapes[t.index()].len()).map(|_| random.signed()).collect()))
        .collect();
    let images: Vec<(&str, &[f32])> = images.iter().map(|(n, i)| (*n, &i[..])).collect();
    let mut run = |threads: usize| {
        let len = |name| engine.shape(name).map_or(0, |s| s.len());
        let [mut color, mut hidden] = ["color", "hidden"].map(|name| vec![0.0_f32; len(name)]);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let mut taken = 0;
        pool.install(|| {
            for frame in 0..20 {
                // The first frames may grow the threads' queues.
                if frame == 4 {
                    taken = COUNT.load(Ordering::Relaxed);
                }
                engine.run(&images, &mut [("color", &mut color), ("hidden", &mut hidden)]).expect("it runs");
            }
            taken = COUNT.load(Ordering::Relaxed) - taken;
        });
        (color, hidden, taken)
    };
    let (color, hidden, taken) = run(1);
    assert_eq!(taken, 0, "allocations in 16 frames");
    assert!(color.iter().all(|v| v.is_finite()) && color.iter().any(|v| v.abs() > 0.1));
    for threads in [2, 5] {
        let (color_again, hidden_again, _) = run(threads);
        assert!(color == color_again && hidden == hidden_again, "{threads} threads");
    }
}
