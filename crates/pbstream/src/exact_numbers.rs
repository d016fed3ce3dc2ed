//! Messages of plain numbers that keep −0.0: the generated ones omit it like 0, but other programs write it.

use prost::bytes::{Buf, BufMut};
use prost::encoding::{DecodeContext, WireType, double, float, skip_field};
use prost::{DecodeError, Message};

macro_rules! numbers {
    ($($name:ident of $number:ident ($encoding:ident): $($field:ident = $tag:literal)+;)+) => {$(
        #[doc = concat!("As in the schema, of `", stringify!($number), "`.")]
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name {
            $(#[doc = concat!("Field ", stringify!($tag), ".")] pub $field: $number,)+
        }

        impl Message for $name {
            fn encode_raw(&self, buffer: &mut impl BufMut) {
                $(if self.$field.to_bits() != 0 {
                    $encoding::encode($tag, &self.$field, buffer);
                })+
            }

            fn merge_field(
                &mut self,
                tag: u32,
                wire_type: WireType,
                buffer: &mut impl Buf,
                context: DecodeContext,
            ) -> Result<(), DecodeError> {
                match tag {
                    $($tag => $encoding::merge(wire_type, &mut self.$field, buffer, context),)+
                    _ => skip_field(wire_type, tag, buffer, context),
                }
            }

            fn encoded_len(&self) -> usize {
                let mut length = 0;
                $(if self.$field.to_bits() != 0 {
                    length += $encoding::encoded_len($tag, &self.$field);
                })+
                length
            }

            fn clear(&mut self) {
                *self = Self::default();
            }
        }
    )+};
}

numbers! {
    Vector2d of f64 (double): x = 1 y = 2;
    Vector2f of f32 (float): x = 1 y = 2;
    Vector3d of f64 (double): x = 1 y = 2 z = 3;
    Vector3f of f32 (float): x = 1 y = 2 z = 3;
    Vector4f of f32 (float): x = 1 y = 2 z = 3 t = 4;
    Quaterniond of f64 (double): x = 1 y = 2 z = 3 w = 4;
    Quaternionf of f32 (float): x = 1 y = 2 z = 3 w = 4;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_zeros_survive_and_zeros_take_no_room() {
        let before = Vector3d { x: -0.0, y: 0.0, z: 1.5 };
        let bytes = before.encode_to_vec();
        assert_eq!(bytes.len(), before.encoded_len());
        assert_eq!(bytes.len(), 18);
        let after = Vector3d::decode(&*bytes).unwrap();
        assert_eq!(after, before);
        assert!(after.x.is_sign_negative() && after.y.is_sign_positive());
        assert!(Quaternionf::default().encode_to_vec().is_empty());
        let w = Quaternionf { w: -0.0, ..Quaternionf::default() };
        assert!(Quaternionf::decode(&*w.encode_to_vec()).unwrap().w.is_sign_negative());
    }
}
