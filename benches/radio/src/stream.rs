//! One direction of a TCP connection: order, acknowledgements and repetition, without fast retransmission and slow start.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::{MessageId, Micros, Settings};

/// Part of a message that fits one IP packet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    pub(crate) message: MessageId,
    pub(crate) octets: u32,
}

/// What goes in one IP packet: a part, or several that have waited together.
#[derive(Clone, Debug)]
pub(crate) struct Segment {
    pub(crate) number: u64,
    pub(crate) messages: Vec<MessageId>,
    pub(crate) octets: u32,
}

#[derive(Debug)]
struct UnderWay {
    segment: Segment,
    sent: Micros,
    /// Whether it lies in the station's queue.
    is_queued: bool,
    is_repeated: bool,
}

/// What a segment's arrival asks for.
#[derive(Debug, Default)]
pub(crate) struct Arrival {
    /// Messages of which a part has come into order.
    pub(crate) parts: Vec<MessageId>,
    /// Whether to acknowledge without delay.
    pub(crate) at_once: bool,
}

/// The sender's and the receiver's side of one direction.
#[derive(Debug)]
pub(crate) struct Stream {
    // The sender's.
    next: u64,
    under_way: BTreeMap<u64, UnderWay>,
    waiting: VecDeque<Part>,
    smoothed: Option<(Micros, Micros)>,
    timeout: Micros,
    /// When the first segment under way is sent again.
    timer: Option<Micros>,
    /// Up to this segment all is to be acknowledged before there may be more than one under way.
    recovers: Option<u64>,
    // The receiver's.
    expected: u64,
    early: BTreeMap<u64, Vec<MessageId>>,
    owed: u32,
    ack_due: Option<Micros>,
}

impl Stream {
    pub(crate) fn new(settings: &Settings) -> Stream {
        Stream {
            next: 0,
            under_way: BTreeMap::new(),
            waiting: VecDeque::new(),
            smoothed: None,
            timeout: settings.first_timeout,
            timer: None,
            recovers: None,
            expected: 0,
            early: BTreeMap::new(),
            owed: 0,
            ack_due: None,
        }
    }

    pub(crate) fn push(&mut self, part: Part) {
        self.waiting.push_back(part);
    }

    /// The next segment that may go out; it is under way then.
    pub(crate) fn pull(&mut self, now: Micros, longest: u32, settings: &Settings) -> Option<Segment> {
        let most = if self.recovers.is_some() {
            1
        } else {
            settings.segments
        };
        if self.under_way.len() >= most.max(1) {
            return None;
        }
        let first = self.waiting.pop_front()?;
        let mut segment = Segment {
            number: self.next,
            messages: vec![first.message],
            octets: first.octets,
        };
        while let Some(part) = self.waiting.front()
            && segment.octets + part.octets <= longest
        {
            segment.messages.push(part.message);
            segment.octets += part.octets;
            self.waiting.pop_front();
        }
        self.next += 1;
        let under_way = UnderWay {
            segment: segment.clone(),
            sent: now,
            is_queued: true,
            is_repeated: false,
        };
        self.under_way.insert(segment.number, under_way);
        self.timer.get_or_insert(now + self.timeout);
        Some(segment)
    }

    /// A segment has left the station's queue, delivered or not.
    pub(crate) fn left(&mut self, number: u64) {
        if let Some(under_way) = self.under_way.get_mut(&number) {
            under_way.is_queued = false;
        }
    }

    /// The receiver has all before this number; whether that is news.
    pub(crate) fn acknowledge(&mut self, now: Micros, before: u64, settings: &Settings) -> bool {
        let rest = self.under_way.split_off(&before);
        let done = std::mem::replace(&mut self.under_way, rest);
        let Some(last) = done.values().next_back() else {
            return false;
        };
        // The round trip of what was sent twice is not known (Karn).
        if !last.is_repeated {
            self.measure(now - last.sent, settings);
        }
        if self.recovers.is_some_and(|until| before >= until) {
            self.recovers = None;
        }
        self.timer = (!self.under_way.is_empty()).then(|| now + self.timeout);
        true
    }

    /// RFC 6298, with the least on top of the round trip: so an acknowledgement that waits as long as is usual is not too late.
    fn measure(&mut self, trip: Micros, settings: &Settings) {
        let (smoothed, varies) = match self.smoothed {
            None => (trip, trip / 2),
            Some((smoothed, varies)) => (
                (7 * smoothed + trip) / 8,
                (3 * varies + (smoothed - trip).abs()) / 4,
            ),
        };
        self.smoothed = Some((smoothed, varies));
        let timeout = smoothed + (4 * varies).max(settings.least_timeout);
        self.timeout = timeout.min(settings.most_timeout);
    }

    /// The timer has run out: the first segment goes again, unless it still lies in the queue.
    pub(crate) fn repeat(&mut self, now: Micros, settings: &Settings) -> Option<Segment> {
        self.timer = None;
        let first = self.under_way.values_mut().next()?;
        self.timer = Some(now + self.timeout);
        if first.is_queued {
            return None;
        }
        (first.is_queued, first.is_repeated) = (true, true);
        let segment = first.segment.clone();
        self.timeout = (self.timeout * 2).min(settings.most_timeout);
        self.timer = Some(now + self.timeout);
        self.recovers = Some(self.next);
        Some(segment)
    }

    /// After an acknowledgement while it recovers: what was sent before the gap was noticed and is not acknowledged goes again, one by one.
    pub(crate) fn go_on(&mut self, now: Micros) -> Option<Segment> {
        self.recovers?;
        let first = self.under_way.values_mut().next()?;
        if first.is_queued {
            return None;
        }
        (first.is_queued, first.is_repeated) = (true, true);
        self.timer = Some(now + self.timeout);
        Some(first.segment.clone())
    }

    /// A segment has come to the receiver.
    pub(crate) fn arrive(
        &mut self,
        now: Micros,
        number: u64,
        messages: Vec<MessageId>,
        delay: Micros,
    ) -> Arrival {
        let mut arrival = Arrival::default();
        if number < self.expected {
            arrival.at_once = true;
            return arrival;
        }
        self.early.insert(number, messages);
        let was = self.early.len();
        while let Some(messages) = self.early.remove(&self.expected) {
            arrival.parts.extend(messages);
            self.expected += 1;
        }
        self.owed += 1;
        // A gap, one that is filled, and every second segment are acknowledged at once.
        arrival.at_once = !self.early.is_empty() || was > 1 || self.owed > 1;
        self.ack_due.get_or_insert(now + delay);
        arrival
    }

    /// The number up to which all is received, to be told with what is sent now.
    pub(crate) fn acknowledged(&mut self) -> u64 {
        (self.owed, self.ack_due) = (0, None);
        self.expected
    }

    pub(crate) const fn ack_due(&self) -> Option<Micros> {
        self.ack_due
    }

    pub(crate) const fn timer(&self) -> Option<Micros> {
        self.timer
    }

    /// All messages that have not arrived.
    pub(crate) fn unfinished(&self) -> BTreeSet<MessageId> {
        let under_way = self.under_way.values().flat_map(|one| &one.segment.messages);
        let waiting = self.waiting.iter().map(|part| &part.message);
        under_way.chain(waiting).copied().collect()
    }
}
