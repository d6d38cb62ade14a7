//! The packet codec and the robot's end allocate nothing, and are small enough for a microcontroller.

mod common;

use std::alloc::{GlobalAlloc, Layout as Memory, System};
use std::cell::Cell;

use common::*;
use mom_rsp::middle::Settings;
use mom_rsp::robot::Body;
use mom_rsp::{Direction, Header, Item, Items, Writer};

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

#[allow(unsafe_code, reason = "an allocator that counts is one that allocates")]
// SAFETY: everything is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, memory: Memory) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
        unsafe { System.alloc(memory) }
    }

    unsafe fn dealloc(&self, at: *mut u8, memory: Memory) {
        unsafe { System.dealloc(at, memory) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(work: impl FnOnce()) -> usize {
    let before = COUNT.with(Cell::get);
    work();
    COUNT.with(Cell::get) - before
}

/// Does nothing, and allocates nothing.
struct Still(u32);

impl Body for Still {
    fn random(&mut self, bytes: &mut [u8]) {
        bytes.fill(5);
    }

    fn effector(&mut self, _: u8, _: &[u8]) {
        self.0 += 1;
    }

    fn command(&mut self, _: u8, _: &[u8]) {
        self.0 += 1;
    }
}

#[test]
fn the_codec_allocates_nothing() {
    let mut packet = [0; 128];
    let count = allocations(|| {
        let mut writer = Writer::new(&CUBO, Direction::Down, &mut packet[Header::LEN..]).expect("space");
        writer.put(LEFT, Item::Value(&[1, 2])).expect("an effector");
        writer
            .put(FIRE, Item::Call { id: 1, data: &[0, 0] })
            .expect("a command");
        let len = writer.finish();
        let items = Items::parse(&CUBO, Direction::Down, &packet[Header::LEN..Header::LEN + len])
            .expect("what was written");
        assert_eq!(items.count(), 2);
    });
    assert_eq!(count, 0);
}

#[test]
fn a_robot_allocates_nothing_in_a_whole_session() {
    for key in [None, Some(KEY)] {
        let settings = Settings {
            key,
            ..Settings::default()
        };
        let mut middle = middle(settings, 1);
        let mut robot = RustCubo::new(&CUBO, robot_settings(key, 500)).expect("the model fits");
        let mut still = Still(0);
        let mut out = [0; 1024];
        let mut count = 0;
        middle.start(0);
        for ms in 0..2000_u16 {
            let now = u64::from(ms) * 1000;
            let data = ms.to_be_bytes();
            let _ = middle.write(LEFT, &data);
            let _ = middle.write(HEAD, &[0, 1]);
            let _ = middle.command(FIRE, &data);
            let _ = middle.command(SAY, &data);
            let _ = middle.set_activated(RANGE, ms % 100 < 50);
            while let Some(packet) = middle.poll(now) {
                let mut datagram = [0; 1024];
                let len = packet.len();
                datagram[..len].copy_from_slice(packet);
                count += allocations(|| {
                    let _ = robot.receive(now, &mut datagram[..len], &mut still);
                });
            }
            count += allocations(|| {
                let _ = robot.set(RANGE, &[0, 0, data[0], data[1]]);
                let _ = robot.raise(BUTTON, &data);
                let _ = robot.raise(CARD, &data);
            });
            loop {
                let mut len = None;
                count += allocations(|| len = robot.poll(now, &mut out, &mut still));
                let Some(len) = len else { break };
                let _ = middle.receive(now, &mut out[..len]);
            }
            while middle.next_notice().is_some() {}
        }
        assert!(still.0 > 100 && robot.counters().accepted() > 100);
        assert_eq!(count, 0);
    }
}

#[test]
fn a_robot_of_16_elements_has_a_kilobyte() {
    assert!(
        std::mem::size_of::<RustCubo>() <= 1024,
        "{}",
        std::mem::size_of::<RustCubo>()
    );
    assert!(CUBO.largest() <= 600, "{}", CUBO.largest());
}
