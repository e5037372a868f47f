//! Reads an MP4 file with one track of H.264, by what the standard says of its boxes.

/// What a file holds.
pub struct Clip {
    /// Width and height of the pictures, as the description of the samples has them.
    pub size: [u32; 2],
    /// Frames per second.
    pub rate: f64,
    /// Content of the box `colr`.
    pub colours: Vec<u8>,
    /// Whether the index comes before the frames.
    pub is_index_first: bool,
    /// Each frame's bytes, and whether it is a key frame.
    pub frames: Vec<(Vec<u8>, bool)>,
    /// Sequence and picture parameters.
    parameters: [Vec<u8>; 2],
}

/// The boxes of `bytes`: kind, content, place of the content.
fn boxes(bytes: &[u8]) -> Vec<(&[u8], &[u8], usize)> {
    let (mut found, mut at) = (Vec::new(), 0);
    while at < bytes.len() {
        let length = int(bytes, at) as usize;
        let (length, header) = match length {
            1 => (u64::from_be_bytes(bytes[at + 8..at + 16].try_into().unwrap()) as usize, 16),
            _ => (length, 8),
        };
        assert!(length >= header && at + length <= bytes.len(), "box at {at} of {length} bytes");
        found.push((&bytes[at + 4..at + 8], &bytes[at + header..at + length], at + header));
        at += length;
    }
    found
}

fn child<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> &'a [u8] {
    let found: Vec<_> = boxes(bytes).into_iter().filter(|b| b.0 == kind).collect();
    assert_eq!(found.len(), 1, "boxes {}", String::from_utf8_lossy(kind));
    found[0].1
}

fn int(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// The entries of a table, `words` numbers each; the table's count is at `at`.
fn table(bytes: &[u8], at: usize, words: usize) -> Vec<Vec<u32>> {
    let count = int(bytes, at) as usize;
    assert_eq!(bytes.len(), at + 4 + 4 * words * count, "a table of {count}");
    (0..count).map(|i| (0..words).map(|k| int(bytes, at + 4 + 4 * (i * words + k))).collect()).collect()
}

impl Clip {
    pub fn read(bytes: &[u8]) -> Self {
        let top = boxes(bytes);
        let kinds: Vec<&[u8]> = top.iter().map(|b| b.0).collect();
        assert_eq!(kinds[0], b"ftyp");
        let place = |kind: &[u8]| kinds.iter().position(|k| *k == kind).unwrap();
        let is_index_first = place(b"moov") < place(b"mdat");
        let (_, data, data_at) = top[place(b"mdat")];
        let track = child(child(bytes, b"moov"), b"trak");
        let media = child(track, b"mdia");
        let index = child(child(media, b"minf"), b"stbl");

        let description = child(index, b"stsd");
        let entry = child(&description[8..], b"avc1");
        let size = [24, 26].map(|at| u32::from(u16::from_be_bytes([entry[at], entry[at + 1]])));
        assert_eq!([88, 92].map(|at| int(child(track, b"tkhd"), at) >> 16), size, "shown size");
        let configuration = child(&entry[78..], b"avcC");
        let colours = child(&entry[78..], b"colr").to_vec();
        let length = usize::from(u16::from_be_bytes([configuration[6], configuration[7]]));
        let sequence = configuration[8..8 + length].to_vec();
        assert_eq!(configuration[1..4], sequence[1..4], "profile and level");
        let at = 8 + sequence.len() + 1;
        let length = usize::from(u16::from_be_bytes([configuration[at], configuration[at + 1]]));
        let picture = configuration[at + 2..at + 2 + length].to_vec();

        let sizes: Vec<usize> = table(child(index, b"stsz"), 8, 1).iter().map(|s| s[0] as usize).collect();
        let keys: Vec<u32> = table(child(index, b"stss"), 4, 1).iter().map(|s| s[0]).collect();
        let times = table(child(index, b"stts"), 4, 2);
        assert_eq!((times.len(), times[0][0] as usize), (1, sizes.len()));
        let scale = int(child(media, b"mdhd"), 20);
        let chunks: Vec<u64> = child(index, b"co64")[8..]
            .chunks_exact(8)
            .map(|place| u64::from_be_bytes(place.try_into().unwrap()))
            .collect();
        let runs = table(child(index, b"stsc"), 4, 3);
        let mut frames = Vec::new();
        let mut end = data_at;
        for (number, chunk) in (1..).zip(&chunks) {
            let run = runs.iter().rev().find(|run| run[0] <= number).unwrap();
            let mut at = *chunk as usize;
            assert_eq!(at, end, "chunks follow each other");
            for _ in 0..run[1] {
                let is_key = keys.contains(&(frames.len() as u32 + 1));
                let length = sizes[frames.len()];
                frames.push((bytes[at..at + length].to_vec(), is_key));
                at += length;
            }
            end = at;
        }
        assert_eq!((frames.len(), end), (sizes.len(), data_at + data.len()), "all data is frames");
        let rate = f64::from(scale) / f64::from(times[0][1]);
        Self { size, rate, colours, is_index_first, frames, parameters: [sequence, picture] }
    }

    /// The stream as decoders take it, units apart by start codes.
    pub fn annex_b(&self) -> Vec<u8> {
        const START: [u8; 4] = [0, 0, 0, 1];
        let mut stream = Vec::new();
        self.parameters.iter().for_each(|set| stream.extend([&START, &set[..]].concat()));
        for (frame, _) in &self.frames {
            let mut at = 0;
            while at < frame.len() {
                let length = int(frame, at) as usize;
                stream.extend([&START, &frame[at + 4..at + 4 + length]].concat());
                at += 4 + length;
            }
        }
        stream
    }
}
