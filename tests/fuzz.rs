//! The fuzz targets with a plain byte mutator: no bytes may make a reader or a write-back panic, hang, or fill the memory.
//!
//! `AVENTAIL_FUZZ_SECONDS` (all threads together) and `AVENTAIL_FUZZ_SEED` say how long and from
//! where; `AVENTAIL_FUZZ_TARGET` names one target. What fails is kept beside the test's other
//! files, and belongs into `tests/corpus`, which is run first.

#[path = "../fuzz/src/lib.rs"]
mod targets;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use targets::{TARGETS, Target};

/// A run that takes longer hangs.
const LONGEST: Duration = Duration::from_secs(5);
/// No small file needs so much memory.
const MOST_MEMORY: u64 = 2 << 30;
/// How long each target runs at a time.
const TURN: Duration = Duration::from_millis(10);
/// What breaks parsers.
const TOKENS: [&str; 40] = [
    "-1",
    "0",
    "1",
    "4294967295",
    "-2147483648",
    "9223372036854775807",
    "18446744073709551616",
    "1e308",
    "-1e-320",
    "1e400",
    "nan",
    "-inf",
    "NaN",
    "[]",
    "{}",
    "null",
    "\"\"",
    "true",
    "[[]]",
    "(",
    ")",
    "none",
    "(nan,nan,nan)",
    "\n",
    "\n\n",
    "\r\n",
    ":",
    ":=",
    "=",
    "#",
    ",",
    "\"",
    "'",
    "\u{feff}",
    "\0",
    "\u{1b}[2J",
    "é",
    "]]>",
    "&#0;",
    "..",
];

/// Marsaglia's xorshift: the same mutations for the same seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 16
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// Changes a file a little, a few times.
fn mutate(data: &mut Vec<u8>, others: &[Vec<u8>], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let (at, len) = (random.below(data.len()), data.len());
        let span = at..(at + 1 + random.below(16)).min(len);
        match random.below(10) {
            0 if len > 0 => data[at] ^= 1 << random.below(8),
            1 if len > 0 => data[at] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'-', b' '][random.below(8)],
            2 if len > 0 => data[at] = random.next() as u8,
            3 => drop(data.drain(span)),
            4 => {
                let copy = data[span].to_vec();
                data.splice(at..at, copy);
            }
            5 => {
                data.splice(at..at, TOKENS[random.below(TOKENS.len())].bytes());
            }
            6 => {
                data.splice(span, TOKENS[random.below(TOKENS.len())].bytes());
            }
            7 => {
                // A whole number as text becomes another.
                let digit = |b: &u8| b.is_ascii_digit() || *b == b'.' || *b == b'-';
                if let Some(start) = data[at..].iter().position(digit).map(|n| at + n) {
                    let end = start + data[start..].iter().take_while(|b| digit(b)).count();
                    data.splice(start..end, TOKENS[random.below(13)].bytes());
                }
            }
            8 if random.below(8) == 0 => data.truncate(at),
            _ => {
                let other = &others[random.below(others.len())];
                let from = random.below(other.len());
                let piece = &other[from..(from + 1 + random.below(24)).min(other.len())];
                data.splice(at..at, piece.iter().copied());
            }
        }
        if data.len() > 1 << 16 {
            data.truncate(1 << 16);
        }
    }
}

/// Runs a target on a file; what fails is kept.
fn run(name: &str, target: fn(&[u8]), data: &[u8]) {
    let timed = || {
        let start = Instant::now();
        (std::panic::catch_unwind(|| target(data)), start.elapsed())
    };
    let (done, first) = timed();
    // A disk may have stood still: a file that takes long takes long again.
    let took = if first > LONGEST { timed().1.min(first) } else { first };
    let (slow, kept) = (took > LONGEST, || {
        let sum = data.iter().fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3));
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{sum:016x}"));
        std::fs::write(&path, data).expect("the failed file can be kept");
        path
    });
    assert!(!slow, "{name} took {took:?} on {}", kept().display());
    assert!(done.is_ok(), "{name} panicked on {}", kept().display());
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// One thread for the readers: tasks as small as these would wait for each other longer than they run.
fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread").install(work)
}

/// Some of the targets in turn, for so long; each has its own mutations and the same time, whatever
/// the others do.
fn take_turns(mine: &[(usize, &Target)], seed: u64, time: Duration) -> u64 {
    let corpora: Vec<Vec<Vec<u8>>> = mine.iter().map(|(_, t)| t.2()).collect();
    for ((_, (name, target, _)), corpus) in mine.iter().zip(&corpora) {
        corpus.iter().for_each(|data| run(name, *target, data));
    }
    let mut random: Vec<Random> = mine
        .iter()
        .map(|(n, _)| Random((seed * 1000 + *n as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1))
        .collect();
    let (start, mut runs) = (Instant::now(), 0u64);
    while start.elapsed() < time {
        for (((_, (name, target, _)), corpus), random) in mine.iter().zip(&corpora).zip(&mut random) {
            let turn = Instant::now();
            while turn.elapsed() < TURN {
                let mut data = corpus[random.below(corpus.len())].clone();
                mutate(&mut data, corpus, random);
                run(name, *target, &data);
                runs += 1;
            }
        }
    }
    targets::clean_up();
    runs
}

#[test]
fn mutated_files_give_answers() {
    let seed = number("AVENTAIL_FUZZ_SEED", 1);
    let only = std::env::var("AVENTAIL_FUZZ_TARGET").ok();
    let wanted = |t: &&Target| only.as_deref().is_none_or(|o| o == t.0);
    let chosen: Vec<_> = TARGETS.iter().filter(wanted).enumerate().collect();
    // The time is that of all threads together; each takes its share of the targets.
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(chosen.len()).max(1);
    let time = Duration::from_secs(number("AVENTAIL_FUZZ_SECONDS", 5)) / threads as u32;
    let share = |n: usize| chosen.iter().copied().skip(n).step_by(threads).collect::<Vec<_>>();
    let runs: u64 = std::thread::scope(|scope| {
        let worker = |n: usize| scope.spawn(move || alone(|| take_turns(&share(n), seed, time)));
        let workers: Vec<_> = (0..threads).map(worker).collect();
        workers.into_iter().map(|w| w.join().expect("a target failed")).sum()
    });
    eprintln!("{runs} runs of {} targets from seed {seed} on {threads} threads", chosen.len());
    let memory = aventail::runtime::peak_memory().unwrap_or(0);
    assert!(memory < MOST_MEMORY, "{memory} bytes of memory");
}

/// Files that once failed, in folders by target.
#[test]
fn what_once_failed_gives_answers() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let files = |folder: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(folder).into_iter().flatten().map(|e| e.expect("an entry").path()).collect()
    };
    alone(|| {
        for (name, target, _) in TARGETS {
            for path in files(&corpus.join(name)) {
                run(name, *target, &std::fs::read(path).expect("a file of the corpus"));
            }
        }
        targets::clean_up();
    });
    let memory = aventail::runtime::peak_memory().unwrap_or(0);
    assert!(memory < MOST_MEMORY, "{memory} bytes of memory");
}
