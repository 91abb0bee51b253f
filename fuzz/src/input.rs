//! Reader that converts the fuzzer's bytes to choices and numbers; after the last byte it reads zeros.

/// Numbers that often break formulas: not finite, huge, tiny and subnormal ones, zeros, π, and usual bounds.
const SPECIAL: [f64; 24] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::MAX,
    f64::MIN,
    f64::MIN_POSITIVE,
    5e-324,
    -5e-324,
    0.0,
    -0.0,
    1e-300,
    1e-150,
    1e-12,
    1e-6,
    1e-3,
    0.01,
    1.0,
    -1.0,
    10.0,
    std::f64::consts::PI,
    1e3,
    1e6,
    -1e6,
    1e150,
];

/// Reader of the fuzzer's bytes, which are interpreted as choices and numbers.
pub struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((&first, rest)) => {
                self.0 = rest;
                first
            }
            None => 0,
        }
    }

    pub fn flag(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count
    }

    pub fn pick<T: Clone>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())].clone()
    }

    /// Returns `usual`, a number near it, a special number, or a number of arbitrary bits.
    pub fn number(&mut self, usual: f64) -> f64 {
        let kind = self.byte();
        match kind % 8 {
            0..4 => usual,
            // From -1.28 to 1.27 times the usual number; if that is 0, from -1.28 to 1.27.
            4 => (if usual == 0.0 { 1.0 } else { usual }) * f64::from(self.byte().cast_signed()) / 100.0,
            5 => usual + f64::from(self.byte().cast_signed()) / 50.0,
            6 => SPECIAL[usize::from(kind / 8) % SPECIAL.len()],
            _ => self.bits(),
        }
    }

    /// Returns the number with the bits of the next eight bytes.
    pub fn bits(&mut self) -> f64 {
        let mut bytes = [0; 8];
        bytes.iter_mut().for_each(|byte| *byte = self.byte());
        f64::from_le_bytes(bytes)
    }

    /// Returns `usual` with up to three numbers replaced, and sometimes with another length.
    pub fn vector(&mut self, usual: &[f64]) -> Vec<f64> {
        let mut values = usual.to_vec();
        let kind = self.byte();
        if kind >= 250 {
            values.resize(self.below(20), 0.1);
        }
        for _ in 0..kind % 4 {
            if !values.is_empty() {
                let at = self.below(values.len());
                values[at] = self.number(values[at]);
            }
        }
        values
    }

    pub fn option<T>(&mut self, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.flag().then(|| make(self))
    }
}
