//! Layouts of Ouster lidar packets: the contents of a channel of a column, by profile.

use crate::bytes::{u16_at, u32_at};

/// Layouts of the channels of lidar packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketProfile {
    /// `LEGACY`, the only one before firmware 2.2.
    Legacy,
    /// `RNG19_RFL8_SIG16_NIR16`.
    Single,
    /// `RNG15_RFL8_NIR8`.
    LowData,
    /// `RNG19_RFL8_SIG16_NIR16_DUAL`.
    Dual,
    /// `FUSA_RNG15_RFL8_NIR8_DUAL`.
    FusaLowDataDual,
    /// `RNG15_RFL8_NIR8_DUAL`.
    LowDataDual,
    /// `FIVE_WORD_PIXEL`.
    FiveWords,
    /// `RNG15_RFL8_NIR8_ZONE16`.
    LowDataZones,
    /// `RNG19_RFL8_SIG16_NIR16_ZONE16`.
    SingleZones,
    /// `RNG19_RFL8_SIG16_ZONE16_DUAL`.
    DualZones,
    /// `RNG15_RFL8_WIN8`.
    LowDataWindow,
    /// `RNG19_RFL8_SIG16_NIR16_RGB16`.
    SingleColour,
    /// `RNG19_RFL8_SIG16_NIR16_RGB16_DUAL`.
    DualColour,
}

/// Encoding of the ranges of a channel.
#[derive(Clone, Copy)]
enum Ranges {
    /// 20 bits, in millimetres.
    Bits20,
    /// 19 bits, in millimetres.
    Bits19,
    /// 15 bits, in units of 8 mm.
    Bits15,
}

/// Layout of a channel.
struct Channel {
    bytes: usize,
    ranges: Ranges,
    /// Offsets of reflectivity, one for each return. The ranges of returns are four bytes apart.
    reflectivities: &'static [usize],
}

impl PacketProfile {
    /// All profiles.
    pub const ALL: [Self; 13] = [
        Self::Legacy,
        Self::Single,
        Self::LowData,
        Self::Dual,
        Self::FusaLowDataDual,
        Self::LowDataDual,
        Self::FiveWords,
        Self::LowDataZones,
        Self::SingleZones,
        Self::DualZones,
        Self::LowDataWindow,
        Self::SingleColour,
        Self::DualColour,
    ];
    /// The profiles that are assumed if only the length of packets is known: the oldest of each size.
    pub(crate) const USUAL: [Self; 6] =
        [Self::Legacy, Self::Single, Self::LowData, Self::Dual, Self::FusaLowDataDual, Self::FiveWords];

    /// Name in metadata (`udp_profile_lidar`).
    pub const fn name(self) -> &'static str {
        match self {
            Self::Legacy => "LEGACY",
            Self::Single => "RNG19_RFL8_SIG16_NIR16",
            Self::LowData => "RNG15_RFL8_NIR8",
            Self::Dual => "RNG19_RFL8_SIG16_NIR16_DUAL",
            Self::FusaLowDataDual => "FUSA_RNG15_RFL8_NIR8_DUAL",
            Self::LowDataDual => "RNG15_RFL8_NIR8_DUAL",
            Self::FiveWords => "FIVE_WORD_PIXEL",
            Self::LowDataZones => "RNG15_RFL8_NIR8_ZONE16",
            Self::SingleZones => "RNG19_RFL8_SIG16_NIR16_ZONE16",
            Self::DualZones => "RNG19_RFL8_SIG16_ZONE16_DUAL",
            Self::LowDataWindow => "RNG15_RFL8_WIN8",
            Self::SingleColour => "RNG19_RFL8_SIG16_NIR16_RGB16",
            Self::DualColour => "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL",
        }
    }

    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|profile| profile.name() == name)
    }

    const fn channel(self) -> Channel {
        let (bytes, ranges, reflectivities): (_, _, &[usize]) = match self {
            Self::Legacy => (12, Ranges::Bits20, &[4]),
            Self::Single | Self::SingleZones => (12, Ranges::Bits19, &[4]),
            Self::SingleColour => (16, Ranges::Bits19, &[3]),
            Self::LowData | Self::LowDataWindow => (4, Ranges::Bits15, &[2]),
            Self::LowDataZones => (8, Ranges::Bits15, &[2]),
            Self::FusaLowDataDual | Self::LowDataDual => (8, Ranges::Bits15, &[2, 6]),
            Self::Dual | Self::DualZones => (16, Ranges::Bits19, &[3, 7]),
            Self::FiveWords | Self::DualColour => (20, Ranges::Bits19, &[3, 7]),
        };
        Channel { bytes, ranges, reflectivities }
    }

    pub(crate) const fn channel_bytes(self) -> usize {
        self.channel().bytes
    }

    /// Range in millimetres and reflectivity of up to two returns of a channel.
    pub(crate) fn returns(self, bytes: &[u8]) -> [Option<(u32, f32)>; 2] {
        let Channel { ranges, reflectivities, .. } = self.channel();
        let one = |number: usize| {
            let at = *reflectivities.get(number)?;
            let range = match ranges {
                Ranges::Bits20 => u32_at(bytes, 4 * number) & 0x000f_ffff,
                Ranges::Bits19 => u32_at(bytes, 4 * number) & 0x0007_ffff,
                Ranges::Bits15 => 8 * (u32::from(u16_at(bytes, 4 * number)) & 0x7fff),
            };
            let reflectivity = match self {
                Self::Legacy => f32::from(u16_at(bytes, at)),
                _ => bytes.get(at).copied().map_or(0.0, f32::from),
            };
            (range > 0).then_some((range, reflectivity))
        };
        [one(0), one(1)]
    }
}
