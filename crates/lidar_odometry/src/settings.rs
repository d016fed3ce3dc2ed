//! Settings of the front end: each with its unit, range, origin and effect.
//!
//! Each entry of the tables in this folder becomes a field with documentation and a default, and a row of
//! [`OdometrySettings::entries`], by which ranges are checked and tables of sensitivity can be made.
//! Constants of single models (of likelihoods, filters and iterations) are in `constants.rs`. Sizes of
//! blocks, layouts of keys and bounds of memory are in the files that use them.
//!
//! The origins are honest: *derived* follows from a sensor or from geometry, a name is a source, *tuned*
//! was found on simulated walks and has no better reason yet.

use portolan_motion::{ImuBasedSettings, PoseExtrapolator};
use thiserror::Error;

/// Makes a table of settings: a struct whose fields have a unit, a range, an origin and an effect.
macro_rules! settings {
    (
        $(#[$meta:meta])*
        $name:ident {
            $(
                $field:ident: $type:ty = $default:expr, $unit:literal, $low:literal..=$high:literal,
                $what:literal,
                origin: $origin:literal,
                larger: $larger:literal;
            )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $(
                #[doc = concat!(
                    $what, ".\n\nUnit: ", $unit, ". Default: ", stringify!($default), ", range ", stringify!($low), " to ",
                    stringify!($high), ". Origin: ", $origin, ". If larger: ", $larger, "."
                )]
                pub $field: $type,
            )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            pub(super) fn entries_into(&self, entries: &mut Vec<$crate::settings::Entry>) {
                $(
                    entries.push($crate::settings::Entry {
                        group: stringify!($name),
                        name: stringify!($field),
                        unit: $unit,
                        values: $crate::settings::Values::values(&self.$field),
                        default: stringify!($default),
                        range: ($low as f64, $high as f64),
                        what: $what,
                        origin: $origin,
                        larger: $larger,
                    });
                )*
            }

            pub(super) fn set_field(&mut self, name: &str, values: &[f64]) -> bool {
                match name {
                    $(stringify!($field) => $crate::settings::Values::set(&mut self.$field, values),)*
                    _ => false,
                }
            }
        }
    };
}

pub(crate) mod constants;
mod for_motion;
mod map;
mod motion;
mod registration;
mod start;

pub use map::{KeyframeSettings, LocalMapSettings, PlaneFitSettings, PoleSettings};
pub use motion::{
    GyroscopeSettings, HypothesisSettings, ImuSettings, InertialSettings, MotionPriorSettings,
    StandstillSettings,
};
pub use registration::{LossSettings, RegistrationSettings, SweepSettings};
pub use start::{CorrelationSettings, InitialisationSettings, VerticalSettings, WitnessSettings};

/// One setting: its name, value, range and documentation.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Name of its struct.
    pub group: &'static str,
    /// Name of the field.
    pub name: &'static str,
    /// Unit, or `1`.
    pub unit: &'static str,
    /// Its value; several for a list.
    pub values: Vec<f64>,
    /// The default as it is written in the source.
    pub default: &'static str,
    /// Minimum and maximum of meaningful values.
    pub range: (f64, f64),
    /// Its meaning.
    pub what: &'static str,
    /// Origin of the default.
    pub origin: &'static str,
    /// Effect of a larger value.
    pub larger: &'static str,
}

/// A setting outside its range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{group}.{name} = {value} is outside {low} to {high}")]
pub struct SettingError {
    /// Name of its struct.
    pub group: &'static str,
    /// Name of the field.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// The minimum meaningful value.
    pub low: f64,
    /// The maximum meaningful value.
    pub high: f64,
}

/// A setting that does not exist, or has another number of values.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("there is no setting {group}.{field} with so many values")]
pub struct UnknownSetting {
    /// Name of the struct that was given.
    pub group: String,
    /// Name of the field that was given.
    pub field: String,
}

/// How the extrapolator predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtrapolatorSettings {
    /// Time over which velocities are computed from poses, seconds.
    pub pose_queue_duration: f64,
    /// Time constant of the average of accelerations that gives gravity, seconds.
    pub gravity_time_constant: f64,
    /// Whether to predict from all odometry and gyroscope data since the last sweep.
    pub use_all_odometry: bool,
    /// Whether to predict by a fit of the last seconds instead, and how.
    pub imu_based: Option<ImuBasedSettings>,
}

impl Default for ExtrapolatorSettings {
    fn default() -> Self {
        Self {
            pose_queue_duration: 0.001,
            gravity_time_constant: 10.0,
            use_all_odometry: true,
            imu_based: None,
        }
    }
}

impl ExtrapolatorSettings {
    /// An extrapolator without data.
    pub fn extrapolator(&self) -> PoseExtrapolator {
        let extrapolator = PoseExtrapolator::new(
            self.pose_queue_duration,
            self.gravity_time_constant,
            self.use_all_odometry,
        );
        match &self.imu_based {
            Some(settings) => extrapolator.with_imu_based(settings),
            None => extrapolator,
        }
    }
}

/// All settings of a lidar odometry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OdometrySettings {
    /// Whether de-skewed sweeps keep intensities.
    pub keeps_intensities: bool,
    /// How the extrapolator predicts.
    pub extrapolator: ExtrapolatorSettings,
    /// Samples of the IMU.
    pub imu: ImuSettings,
    /// Errors of the gyroscope, and its range.
    pub gyroscope: GyroscopeSettings,
    /// Zero-velocity updates.
    pub standstill: StandstillSettings,
    /// The inertial filter.
    pub inertial: InertialSettings,
    /// Standard deviations of predictions.
    pub motion_prior: MotionPriorSettings,
    /// When alternative predictions are tried.
    pub hypotheses: HypothesisSettings,
    /// Which points of a sweep are registered, and when the result is accepted.
    pub sweep: SweepSettings,
    /// When the pose is lost.
    pub loss: LossSettings,
    /// Registration to planes.
    pub registration: RegistrationSettings,
    /// Vertical structures.
    pub poles: PoleSettings,
    /// Planes of voxels.
    pub plane_fit: PlaneFitSettings,
    /// The planar voxel maps around the scanner.
    pub local_map: LocalMapSettings,
    /// Key frames.
    pub keyframes: KeyframeSettings,
    /// The first sweeps.
    pub initialisation: InitialisationSettings,
    /// Correlation of two sweeps.
    pub correlation: CorrelationSettings,
    /// The second, independent measurement of the distance travelled.
    pub witness: WitnessSettings,
    /// Estimation of the vertical from planes.
    pub vertical: VerticalSettings,
}

impl OdometrySettings {
    /// Distance from their plane, metres, beyond which points of sweeps have little weight in the final
    /// iterations.
    pub(crate) fn final_scale(&self) -> f64 {
        self.registration.final_scale_per_edge * self.local_map.voxel_size
    }

    /// Spacing of the points of the first sweeps, metres.
    pub(crate) fn first_spacing(&self) -> f32 {
        self.sweep.first_spacing_per_edge * self.local_map.voxel_size as f32
    }

    /// All settings in the order of their groups.
    pub fn entries(&self) -> Vec<Entry> {
        let mut all = Vec::new();
        self.imu.entries_into(&mut all);
        self.gyroscope.entries_into(&mut all);
        self.standstill.entries_into(&mut all);
        self.inertial.entries_into(&mut all);
        self.motion_prior.entries_into(&mut all);
        self.hypotheses.entries_into(&mut all);
        self.sweep.entries_into(&mut all);
        self.loss.entries_into(&mut all);
        self.registration.entries_into(&mut all);
        self.poles.entries_into(&mut all);
        self.plane_fit.entries_into(&mut all);
        self.local_map.entries_into(&mut all);
        self.keyframes.entries_into(&mut all);
        self.initialisation.entries_into(&mut all);
        self.correlation.entries_into(&mut all);
        self.witness.entries_into(&mut all);
        self.vertical.entries_into(&mut all);
        all
    }

    /// Changes one setting, given by its group and field as [`Self::entries`] names them, to as many
    /// values as it has.
    ///
    /// # Errors
    ///
    /// If there is none of this name, or it has another number of values.
    pub fn set(&mut self, group: &str, field: &str, values: &[f64]) -> Result<(), UnknownSetting> {
        let is_set = match group {
            "ImuSettings" => self.imu.set_field(field, values),
            "GyroscopeSettings" => self.gyroscope.set_field(field, values),
            "StandstillSettings" => self.standstill.set_field(field, values),
            "InertialSettings" => self.inertial.set_field(field, values),
            "MotionPriorSettings" => self.motion_prior.set_field(field, values),
            "HypothesisSettings" => self.hypotheses.set_field(field, values),
            "SweepSettings" => self.sweep.set_field(field, values),
            "LossSettings" => self.loss.set_field(field, values),
            "RegistrationSettings" => self.registration.set_field(field, values),
            "PoleSettings" => self.poles.set_field(field, values),
            "PlaneFitSettings" => self.plane_fit.set_field(field, values),
            "LocalMapSettings" => self.local_map.set_field(field, values),
            "KeyframeSettings" => self.keyframes.set_field(field, values),
            "InitialisationSettings" => self.initialisation.set_field(field, values),
            "CorrelationSettings" => self.correlation.set_field(field, values),
            "WitnessSettings" => self.witness.set_field(field, values),
            "VerticalSettings" => self.vertical.set_field(field, values),
            _ => false,
        };
        is_set.then_some(()).ok_or_else(|| UnknownSetting { group: group.into(), field: field.into() })
    }

    /// Checks that every setting is within its range.
    ///
    /// # Errors
    ///
    /// The first setting that is outside its range.
    pub fn check(&self) -> Result<(), SettingError> {
        for Entry { group, name, values, range: (low, high), .. } in self.entries() {
            if let Some(value) = values.into_iter().find(|v| !(low..=high).contains(v)) {
                return Err(SettingError { group, name, value, low, high });
            }
        }
        Ok(())
    }
}

/// Value of a setting: a number, or a list of numbers.
trait Values {
    fn values(&self) -> Vec<f64>;

    /// Sets the values. False if their number is wrong.
    fn set(&mut self, values: &[f64]) -> bool;
}

macro_rules! number {
    ($($type:ty),*) => {
        $(
            impl Values for $type {
                fn values(&self) -> Vec<f64> {
                    vec![*self as f64]
                }

                fn set(&mut self, values: &[f64]) -> bool {
                    let [value] = values else { return false };
                    *self = *value as $type;
                    true
                }
            }
        )*
    };
}

number!(f32, f64, u16, u32, usize);

impl<T: Values, const N: usize> Values for [T; N] {
    fn values(&self) -> Vec<f64> {
        self.iter().flat_map(Values::values).collect()
    }

    fn set(&mut self, values: &[f64]) -> bool {
        values.len() == N && self.iter_mut().zip(values).all(|(entry, value)| entry.set(&[*value]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_within_their_ranges_and_documented() {
        let settings = OdometrySettings::default();
        assert_eq!(settings.check(), Ok(()));
        let entries = settings.entries();
        // Few enough to be read at once.
        assert!((60..=79).contains(&entries.len()), "{}", entries.len());
        for entry in &entries {
            let texts = [entry.unit, entry.default, entry.what, entry.origin, entry.larger];
            assert!(texts.iter().all(|text| !text.is_empty() && !text.ends_with('.')), "{entry:?}");
        }
    }

    #[test]
    fn every_setting_can_be_set_by_its_name() {
        for entry in OdometrySettings::default().entries() {
            let mut settings = OdometrySettings::default();
            let values: Vec<f64> = entry.values.iter().map(|value| 2.0 * value + 1.0).collect();
            assert_eq!(settings.set(entry.group, entry.name, &values), Ok(()));
            let changed: Vec<Entry> =
                settings.entries().into_iter().filter(|e| e.values != default_of(e)).collect();
            assert_eq!(changed.len(), 1, "{}", entry.name);
            assert!(settings.set(entry.group, entry.name, &[]).is_err());
        }
        assert!(OdometrySettings::default().set("SweepSettings", "nothing", &[1.0]).is_err());
    }

    fn default_of(entry: &Entry) -> Vec<f64> {
        let all = OdometrySettings::default().entries();
        all.into_iter().find(|e| (e.group, e.name) == (entry.group, entry.name)).unwrap().values
    }

    #[test]
    fn a_setting_outside_its_range_is_named() {
        let mut settings = OdometrySettings::default();
        settings.standstill.bin = -1.0;
        let error = settings.check().unwrap_err();
        assert_eq!((error.name, error.value), ("bin", -1.0));
        assert!(error.to_string().starts_with("StandstillSettings.bin = -1 is outside"), "{error}");
    }
}
