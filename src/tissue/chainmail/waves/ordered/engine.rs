//! The propagation: one loop for every variant of which more than first arrivals is asked (those alone are `shortest`'s). A queue
//! says which element is processed next, a carrier what its links hand on, the source which bones send out the wave.

use super::super::super::lattice::Lattice;
use super::super::super::lattice::Node;
use super::super::super::variants::{Order, Structures};
use super::super::carry::{Carrier, Parcel};
use super::super::front::{FrontRules, Hop, NEVER, Source};
use super::queue::{BucketQueue, HeapQueue, Queue};

/// Everything that the waves of one propagation share.
pub struct Scene<'a> {
    /// The elements.
    pub lattice: &'a Lattice,
    /// Links and times.
    pub rules: FrontRules,
    /// What is processed next.
    pub order: Order,
    /// Averaging along wave fronts.
    pub structures: Structures,
    /// What bones hand to tissue.
    pub carrier: Carrier<'a>,
}

/// How one wave went.
pub struct Wave {
    /// Ticks along the path by which each node was reached; 0 in the wave's bones, [`NEVER`] where it did not come.
    pub time: Vec<u32>,
    /// What each node was told.
    pub trace: Trace,
}

/// Each node's part in a wave.
#[derive(Default)]
pub struct Trace {
    /// Nodes of soft tissue in the order in which they were processed.
    pub order: Vec<u32>,
    /// Bone whose motion each reached node has.
    pub owner: Vec<u16>,
    /// What each reached node holds; empty when bones hand on their motion undiminished.
    pub parcel: Vec<Parcel>,
    parent: Vec<u32>,
    info: Vec<Info>,
}

/// What an element has been told, where offers are averaged.
#[derive(Clone, Copy, Default)]
struct Info {
    /// Offers so far.
    count: u8,
    /// Of these, not along the front.
    direct: u8,
    /// Least number of steps along the front that an offer took since its corner; 0 for none.
    steps: u16,
    /// Sum of the offers' weights 1 / t.
    weight: f32,
}

impl Info {
    /// Steps along the front from where informations of earlier fronts met.
    fn steps(self) -> u16 {
        if self.direct >= 2 { 0 } else { self.steps }
    }
}

/// Runs one wave.
///
/// `latest`: a time for each node, after which the wave does not enter it.
///
/// Bones other than the source are not entered (thesis 5.4.2). Timestamps are the unique least path sums, and of several
/// fastest parents the first in storage counts, whatever the order of processing.
pub fn run(scene: &Scene<'_>, source: Source, latest: Option<&[u32]>) -> Wave {
    let links = scene.rules.links(scene.lattice);
    if scene.order == Order::Timestamps && scene.structures == Structures::None {
        let shear = scene.lattice.constraint.iter().fold(0f32, |most, c| most.max(c.shear));
        let queue = BucketQueue::new(scene.rules.ticks_of(&links, shear)[1]);
        return Engine::new(scene, links, queue, latest).run(source);
    }
    Engine::new(scene, links, HeapQueue::new(scene.order, scene.structures), latest).run(source)
}

struct Engine<'a, Q: Queue> {
    scene: &'a Scene<'a>,
    links: Vec<Hop>,
    limit: u32,
    latest: Option<&'a [u32]>,
    queue: Q,
    rank: Vec<Q::Rank>,
    done: Vec<bool>,
    trace: Trace,
}

impl<'a, Q: Queue> Engine<'a, Q> {
    fn new(scene: &'a Scene<'a>, links: Vec<Hop>, queue: Q, latest: Option<&'a [u32]>) -> Self {
        let n = scene.lattice.node.len();
        let trace = Trace {
            order: Vec::new(),
            owner: vec![0; n],
            parcel: vec![Parcel::default(); if scene.carrier.carries() { n } else { 0 }],
            parent: vec![u32::MAX; n],
            info: vec![Info::default(); if queue.averages() { n } else { 0 }],
        };
        Self {
            scene,
            links,
            limit: scene.rules.limit(),
            latest,
            queue,
            rank: vec![Q::NEVER; n],
            done: vec![false; n],
            trace,
        }
    }

    fn run(mut self, source: Source) -> Wave {
        self.start(source);
        while let Some((rank, n)) = self.queue.pop() {
            let n = n as usize;
            if self.done[n] || rank != self.rank[n] {
                continue;
            }
            self.done[n] = true;
            let trace = &mut self.trace;
            if self.scene.lattice.node[n] == Node::Soft {
                trace.order.push(n as u32);
            }
            if let (Some(info), Some(parcel)) = (trace.info.get(n), trace.parcel.get_mut(n))
                && info.count > 0
            {
                *parcel = parcel.scaled(info.weight.recip());
            }
            for at in 0..self.links.len() {
                let hop = self.links[at];
                self.offer(n, &hop);
            }
        }
        (self.trace.parent, self.trace.info) = (Vec::new(), Vec::new());
        Wave { time: Q::times(self.rank), trace: self.trace }
    }

    /// Bones hold their motion; their surfaces send it out.
    fn start(&mut self, source: Source) {
        let lattice = self.scene.lattice;
        for &n in &lattice.active {
            let Some(bone) = source.holds(lattice.node[n as usize]) else { continue };
            self.rank[n as usize] = Q::START;
            self.trace.owner[n as usize] = bone;
            if let Some(parcel) = self.trace.parcel.get_mut(n as usize) {
                *parcel = self.scene.carrier.seed(bone, &lattice.rest(n as usize));
            }
            let surface = |h: &Hop| lattice.node[(n as isize + h.offset) as usize] == Node::Soft;
            if self.links.iter().any(surface) {
                self.queue.push(Q::START, n);
            }
        }
    }

    /// Node `n`, which is settled, offers what it holds to a neighbour.
    fn offer(&mut self, n: usize, hop: &Hop) {
        let lattice = self.scene.lattice;
        let m = (n as isize + hop.offset) as usize;
        if lattice.node[m] != Node::Soft || self.done[m] {
            return;
        }
        let time = Q::time(self.rank[n]) + self.scene.rules.between(lattice, n, m, hop.mm);
        let late = self.latest.is_some_and(|latest| time > latest[m]);
        if time > self.limit || late {
            return;
        }
        let held = self.rank[m];
        let trace = &mut self.trace;
        let (owner, carrier) = (trace.owner[n], &self.scene.carrier);
        let parcel = trace.parcel.get(n).copied();
        let hand_on = || parcel.map(|p| carrier.hand_on(lattice, &p, owner, [n, m], hop));
        if self.queue.averages() {
            return self.inform([n, m], time, hand_on().unwrap_or_default());
        }
        let early = self.queue.by_shift().then(hand_on).flatten();
        let shift = if self.queue.by_shift() {
            carrier.displacement(&early.unwrap_or_default(), owner, &lattice.rest(m)).norm() as f32
        } else {
            0.0
        };
        let rank = self.queue.rank(time, shift);
        if rank > held || (rank == held && trace.parent[m] as usize <= n) {
            return;
        }
        trace.parent[m] = n as u32;
        trace.owner[m] = owner;
        if let Some(p) = early.or_else(hand_on) {
            trace.parcel[m] = p;
        }
        if rank < held {
            self.rank[m] = rank;
            self.queue.push(rank, m as u32);
        }
    }

    /// Adds an offer to what a node has been told by the same bone (thesis eq. 5.9-5.10). Of several bones the one that
    /// comes first counts.
    fn inform(&mut self, [n, m]: [usize; 2], time: u32, parcel: Parcel) {
        let trace = &mut self.trace;
        let mut first = if self.rank[m] == Q::NEVER { NEVER } else { Q::time(self.rank[m]) };
        if first != NEVER && trace.owner[m] != trace.owner[n] {
            if time >= first {
                return;
            }
            first = NEVER;
        }
        if first == NEVER {
            trace.info[m] = Info::default();
            trace.owner[m] = trace.owner[n];
            if let Some(p) = trace.parcel.get_mut(m) {
                *p = Parcel::default();
            }
        }
        let along = (time > first).then(|| trace.info[n].steps().saturating_add(1));
        // Along a front only elements that have been told more inform those that have been told less.
        if along.is_some() && trace.info[n].count <= trace.info[m].count {
            return;
        }
        let info = &mut trace.info[m];
        info.count = info.count.saturating_add(1);
        match along {
            None => info.direct = info.direct.saturating_add(1),
            Some(steps) => info.steps = if info.steps == 0 { steps } else { info.steps.min(steps) },
        }
        let weight = (time as f32).recip();
        info.weight += weight;
        if let Some(p) = trace.parcel.get_mut(m) {
            *p = p.plus(&parcel.scaled(weight));
        }
        let rank = self.queue.informed(time.min(first), trace.info[m].count, trace.info[m].steps());
        self.rank[m] = rank;
        self.queue.push(rank, m as u32);
    }
}
