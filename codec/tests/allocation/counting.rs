//! An allocator that counts the bytes that each thread holds.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

/// Bytes held by a thread now and at peak; counted per thread because tests run in parallel.
#[derive(Debug, Clone, Copy)]
struct Count {
    held: isize,
    peak: isize,
}

thread_local! {
    static COUNT: Cell<Count> = const { Cell::new(Count { held: 0, peak: 0 }) };
}

fn count(by: isize) {
    COUNT.with(|count| {
        let held = count.get().held + by;
        count.set(Count { held, peak: count.get().peak.max(held) });
    });
}

struct Counting;

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller upholds the contract, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: the caller upholds the contract, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // Both blocks exist while the bytes are copied.
        count(new_size as isize);
        count(-(layout.size() as isize));
        // SAFETY: the caller upholds the contract, which is the same.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Peak of the bytes held while `work` runs, beyond those held before.
pub(crate) fn peak_bytes(work: impl FnOnce()) -> usize {
    let before = COUNT.get().held;
    COUNT.set(Count { held: before, peak: before });
    work();
    (COUNT.get().peak - before) as usize
}
