//! What the traversal asks of memory: a stack that is not cleared for each ray, lines fetched ahead, and huge pages.

#![allow(unsafe_code)]

use std::mem::MaybeUninit;

/// Room for `N` values, uninitialised.
pub struct StackMemory<T: Copy, const N: usize>([MaybeUninit<T>; N]);

impl<T: Copy, const N: usize> StackMemory<T, N> {
    /// Room with nothing in it.
    #[inline(always)]
    pub const fn new() -> Self {
        Self([const { MaybeUninit::uninit() }; N])
    }

    /// An empty stack in this room. It is apart from its memory so that its length stays in a register.
    #[inline(always)]
    pub fn stack(&mut self) -> Stack<'_, T, N> {
        Stack { items: &mut self.0, len: 0 }
    }
}

/// At most `N` values.
pub struct Stack<'a, T: Copy, const N: usize> {
    // The first `len` items are initialised.
    items: &'a mut [MaybeUninit<T>; N],
    len: usize,
}

impl<T: Copy, const N: usize> Stack<'_, T, N> {
    /// Puts `item` on top. Panics when full.
    #[inline(always)]
    pub fn push(&mut self, item: T) {
        self.items[self.len].write(item);
        self.len += 1;
    }

    /// Puts the first `count` of `items` on top, in their order. Panics when there is no room for all eight.
    #[inline(always)]
    pub fn push_first(&mut self, items: [T; 8], count: usize) {
        for (room, item) in self.items[self.len..self.len + 8].iter_mut().zip(items) {
            room.write(item);
        }
        self.len += count.min(8);
    }

    /// Puts `item` on top, or not, without a branch. Panics when full.
    #[inline(always)]
    pub fn push_if(&mut self, item: T, really: bool) {
        self.items[self.len].write(item);
        self.len += usize::from(really);
    }

    /// Keeps the items that `keep` wants, without a branch for each.
    #[inline(always)]
    pub fn retain(&mut self, keep: impl Fn(T) -> bool) {
        let mut kept = 0;
        for at in 0..self.len {
            // SAFETY: the item is below `len`, so it was written.
            let item = unsafe { self.items[at].assume_init() };
            self.items[kept].write(item);
            kept += usize::from(keep(item));
        }
        self.len = kept;
    }

    /// Takes the top, if any.
    #[inline(always)]
    pub fn pop(&mut self) -> Option<T> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: the item is below the old `len`, so it was written.
        Some(unsafe { self.items[self.len].assume_init() })
    }

    /// Drops everything.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// How many there are.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.len
    }

    /// The items from `start` on, the top last.
    #[inline(always)]
    pub fn above(&mut self, start: usize) -> &mut [T] {
        let items = &mut self.items[start..self.len];
        // SAFETY: all of them are below `len`, so they were written.
        unsafe { &mut *(std::ptr::from_mut(items) as *mut [T]) }
    }
}

/// Asks for the cache lines of an item that is soon read. Any index is fine, though a wrong one is of no use.
#[inline(always)]
pub fn prefetch<T>(items: &[T], index: usize) {
    prefetch_lines(items.as_ptr().wrapping_add(index).cast());
}

/// Asks for four cache lines from `address` on, which may be any at all.
#[inline(always)]
pub fn prefetch_lines(address: *const u8) {
    for line in 0..4 {
        prefetch_address(address.wrapping_add(64 * line));
    }
}

/// Asks for the cache line in which `item` begins.
#[inline(always)]
pub fn prefetch_line<T>(item: &T) {
    prefetch_address(std::ptr::from_ref(item).cast());
}

#[inline(always)]
fn prefetch_address(address: *const u8) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: SSE is part of x86-64, and a prefetch of any address at all has no effect but on caches.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}

/// From here on huge pages are asked for: smaller tables have their addresses in the processor's own table of pages anyway.
const HUGE_BYTES_MIN: usize = 8 << 20;

/// Room for so many items, in huge pages if they take so much and the system has some to give: rays go everywhere in a large table, and
/// where a small page lies is looked up in memory, too.
pub fn with_room<T>(count: usize) -> Vec<T> {
    let mut items = Vec::with_capacity(count);
    if count.saturating_mul(size_of::<T>()) >= HUGE_BYTES_MIN {
        ask_for_huge_pages(items.spare_capacity_mut());
    }
    items
}

#[cfg(target_os = "linux")]
fn ask_for_huge_pages<T>(room: &mut [MaybeUninit<T>]) {
    let page = rustix::param::page_size();
    let room = room.as_mut_ptr_range();
    let (start, end) = (room.start.addr().next_multiple_of(page), room.end.addr() / page * page);
    // SAFETY: the pages lie within the room, which is borrowed. The advice changes how they are mapped, never what they hold; where
    // it cannot be followed nothing is lost.
    let _ = unsafe {
        rustix::mm::madvise(
            room.start.with_addr(start).cast(),
            end.saturating_sub(start),
            rustix::mm::Advice::LinuxHugepage,
        )
    };
}

#[cfg(not(target_os = "linux"))]
fn ask_for_huge_pages<T>(_: &mut [MaybeUninit<T>]) {}

#[cfg(test)]
mod tests {
    use super::{HUGE_BYTES_MIN, with_room};

    /// There is room for all items and for no more, few or many, whatever their size, and what is put there stays.
    #[test]
    fn there_is_just_room() {
        for count in [0, 1, HUGE_BYTES_MIN / 12 - 1, HUGE_BYTES_MIN / 12 + 1] {
            let mut items = with_room(count);
            assert_eq!(items.capacity(), count);
            items.extend((0..count as u32).map(|i| [i, !i, i * 3]));
            assert_eq!(items.capacity(), count);
            let is_right = |(i, item): (u32, &[u32; 3])| *item == [i, !i, i * 3];
            assert!((0..).zip(&items).all(is_right), "{count} items");
        }
    }
}
