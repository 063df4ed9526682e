//! A stack of fixed size whose memory is not cleared for each ray.

#![allow(unsafe_code)]

use std::mem::MaybeUninit;

/// At most `N` values.
pub struct Stack<T: Copy, const N: usize> {
    // The first `len` items are initialised.
    items: [MaybeUninit<T>; N],
    len: usize,
}

impl<T: Copy, const N: usize> Stack<T, N> {
    /// An empty stack.
    #[inline(always)]
    pub fn new() -> Self {
        Self { items: [const { MaybeUninit::uninit() }; N], len: 0 }
    }

    /// Puts `item` on top. Panics when full.
    #[inline(always)]
    pub fn push(&mut self, item: T) {
        self.items[self.len].write(item);
        self.len += 1;
    }

    /// Takes the top, if any.
    #[inline(always)]
    pub fn pop(&mut self) -> Option<T> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: the item is below the old `len`, so it was written.
        Some(unsafe { self.items[self.len].assume_init() })
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
