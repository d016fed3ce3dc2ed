//! Converts tables of options to messages and back, field by field.

/// A value of an option that has a counterpart `M` in messages.
pub(super) trait OptionMessage<M>: Sized {
    /// The value for a message.
    fn to_message(&self) -> M;

    /// The value from a message. `fallback` replaces absent nested messages, as in files older than the
    /// option. Absent numbers are zero and stay zero.
    fn of_message(message: &M, fallback: &Self) -> Self;
}

macro_rules! unchanged {
    ($($kind:ty),*) => { $(
        impl OptionMessage<$kind> for $kind {
            fn to_message(&self) -> $kind {
                *self
            }
            fn of_message(message: &$kind, _: &Self) -> Self {
                *message
            }
        }
    )* };
}

unchanged!(bool, i32, f32, f64);

impl OptionMessage<i32> for usize {
    fn to_message(&self) -> i32 {
        i32::try_from(*self).unwrap_or(i32::MAX)
    }
    fn of_message(message: &i32, _: &Self) -> Self {
        usize::try_from(*message).unwrap_or(0)
    }
}

/// Numbers of points are stored as floating-point numbers in messages.
impl OptionMessage<f32> for usize {
    fn to_message(&self) -> f32 {
        *self as f32
    }
    fn of_message(message: &f32, _: &Self) -> Self {
        *message as usize
    }
}

/// Maps a table of options to its message: fields of the same name, then those with another name
/// (`ours => theirs`), then fields of the message that have no counterpart and stay empty.
macro_rules! option_message {
    (
        $options:path => $message:path { $($same:ident),* }
        $(, { $($ours:ident => $theirs:ident),* })? $(, empty { $($empty:ident),* })?
    ) => {
        impl OptionMessage<$message> for $options {
            fn to_message(&self) -> $message {
                $message {
                    $($same: OptionMessage::to_message(&self.$same),)*
                    $($($theirs: OptionMessage::to_message(&self.$ours),)*)?
                    $($($empty: Default::default(),)*)?
                }
            }
            fn of_message(message: &$message, fallback: &Self) -> Self {
                $options {
                    $($same: OptionMessage::of_message(&message.$same, &fallback.$same),)*
                    $($($ours: OptionMessage::of_message(&message.$theirs, &fallback.$ours),)*)?
                }
            }
        }
        $crate::convert::option_message::nested_message!($options => $message);
    };
}

/// Conversion of a table that is a nested message, or an optional one.
macro_rules! nested_message {
    ($options:path => $message:path) => {
        impl OptionMessage<Option<$message>> for $options {
            fn to_message(&self) -> Option<$message> {
                Some(self.to_message())
            }
            fn of_message(message: &Option<$message>, fallback: &Self) -> Self {
                match message {
                    Some(message) => Self::of_message(message, fallback),
                    None => fallback.clone(),
                }
            }
        }
        impl OptionMessage<Option<$message>> for Option<$options> {
            fn to_message(&self) -> Option<$message> {
                self.as_ref().map(OptionMessage::to_message)
            }
            fn of_message(message: &Option<$message>, _: &Self) -> Self {
                message.as_ref().map(|m| OptionMessage::of_message(m, &<$options>::default()))
            }
        }
    };
}

pub(super) use {nested_message, option_message};
