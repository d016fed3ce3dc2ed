//! Table of all kinds of issues with severity and text. `{name}` in a text is replaced by the issue's datum of that
//! name.

use crate::Severity;

macro_rules! kinds {
    ($($(#[$attribute:meta])* $kind:ident $severity:ident $text:literal)*) => {
        /// Kind of an issue: what was wrong with the data, and how it was handled.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum IssueKind {
            $($(#[$attribute])* #[doc = $text] $kind,)*
        }

        impl IssueKind {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// Default severity.
            pub const fn severity(self) -> Severity {
                match self {
                    $(Self::$kind => Severity::$severity,)*
                }
            }

            /// Text with placeholders for data.
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$kind => $text,)*
                }
            }

            /// Name of the variant in the code.
            const fn identifier(self) -> &'static str {
                match self {
                    $(Self::$kind => stringify!($kind),)*
                }
            }
        }
    };
}

kinds! {
    // Files and containers of recordings.
    FileLeftOut Error "a file of the recording was left out: {error}"
    ListedFileMissing Error "a file listed in metadata.yaml is missing"
    NoFilesListed Info "metadata.yaml lists no files; the files of the folder were taken in order of name"
    FileChanged Error "the file changed while it was read"
    HighCompression Error "the file claims a compression ratio of more than 256 to 1; only its start was read"
    DamagedCompression Error "the compressed file is damaged or cut off; what could be decompressed was read"
    DamagedCompressedText Error "the compressed file is damaged or cut off ({error}); what follows is lost"
    MissingIndex Info "the recording was not ended properly and has no index; the file was scanned instead"
    EmptyRecording Warning "{file} has no messages"
    DamagedIndex Info "the index is damaged; the file was scanned instead"
    MissingSummary Info "the recording was not ended properly and has no summary; the file was scanned instead"
    DamagedSummary Info "the summary is damaged; the file was scanned instead"
    DamagedChunkIndex Info "the index of a chunk is damaged; the index of the file was used instead"
    WrongIndexLength Info "an index record with a wrong length was read by its number of entries"
    MissingIndexedChunks Error "chunks listed in the index are missing"
    MissingSummarizedChunks Error "chunks listed in the summary are missing"
    UnreadableBytes Error "unreadable bytes between records were skipped"
    CutRecord Error "the file ends in the middle of a record"
    DamagedRecords Error "damaged records were skipped"
    TooLongRecord Error "a record that claims to be longer than the file was skipped"
    MalformedTopic Error "the description of a topic is malformed"
    UnknownChunkCompression Error "a chunk with an unknown compression was skipped"
    WrongChunkLength Info "a chunk of a wrong length was read record by record"
    UnreadableChunk Error "a chunk from which nothing could be read was skipped"
    HugeChunk Error "a chunk of more than 1 GiB was skipped"
    HighChunkCompression Error "a chunk that claims a compression ratio of more than 256 to 1 was read in part"
    DamagedChunkCompression Error "the compressed data of a chunk are damaged; what could be decompressed was kept"
    ShortChunk Error "a chunk is shorter than it should be; its whole records were kept"
    WrongChunkChecksum Error "the checksum of a chunk is wrong; its readable messages were kept"
    LaterThanIndexed Info "a message came later than the index of the recording promised: it is out of order"
    DamagedMessageCompression Error "a message on {topic} was dropped: its zstd compression is damaged"
    DamagedMessage Error "a message on {topic} ({type}) was dropped: {error}"
    UnusableWriteAheadLog Error "the write-ahead log of the database could not be used; its messages are missing"
    DamagedDatabase Error "the database is damaged; what is readable in it was read"
    DatabaseReadByRow Error "the database is damaged; what is readable in it was read row by row"
    EndlessDatabase Error "the pages of the database refer to each other without end; reading was given up"
    DatabaseGap Error "a part of the database could not be read and was skipped"
    UndescribedTopic Error "messages of a topic without a description were dropped"
    UnreadableDatabaseMessage Error "a message on {topic} could not be read from the database"
    DatabaseOutOfOrder Info "a message of a damaged database came out of order"
    FurtherKinds Warning "further kinds of damage"
    /// Issue of a recording format that a user of the library implements.
    Other Info "{what}"

    // Text logs and folders.
    UnreadableLine Error "lines that could not be parsed were left out"
    UnreadableLineTime Error "lines with an unreadable time were left out"
    OverlongLine Error "lines longer than 1 MiB were left out"
    LineNotLater Error "lines whose time is not later than that of the line before were left out"
    LinesReordered Info "lines out of order were put in order of time"
    LinesOutOfOrder Info "lines more than 10 s out of order were kept in the order of the file"
    RepeatedScan Warning "scans that repeat the readings of the scan before under another stamp were left out: nothing new was measured"
    RepeatedMessage Info "messages that repeat the one before were left out"
    ScanInOtherFormat Info "scans that the log also has in a better format were left out"
    UnusedLines Info "lines of kind {kind} hold nothing that mapping uses"
    CutSweep Error "sweeps whose last point is cut off were read without it"
    HugeSweep Error "points of sweeps beyond two million were left out"
    SweepWithoutPoints Error "sweeps without a point were left out"
    UnreadableOxts Error "OXTS readings (GNSS and IMU) that could not be parsed were left out"
    UnreadableFiles Error "files in {folder} that cannot be read or are too long were left out"
    WithoutTime Error "{what} without a time were left out"
    UnreadableCalibration Info "calib_imu_to_velo.txt could not be parsed; the usual mounting pose of the lidar was used"

    // Packets of lidars, and captures of them.
    DamagedCapture Error "the capture is damaged; what follows was left out"
    CutCapture Error "the capture ends in the middle of a packet"
    UnknownInterface Error "packets of an interface that the capture does not describe were left out"
    WrongPacketLength Error "packets of a wrong length were left out"
    RareSender Error "packets of senders with very few packets were left out: their address is damaged, or they started late"
    UnknownPacketSensor Error "packets of {bytes} bytes are of no known sensor and were left out"
    /// Network cards and recorders deliver some packets twice.
    RepeatedPacket Info "exact repetitions of the packet before were left out"
    /// Another sender uses the UDP port of a Velodyne.
    NotVelodyne Error "packets that are not Velodyne data packets were left out"
    /// The product byte of a packet is unknown.
    UnknownVelodyne Warning "packets of an unknown Velodyne product were read as those of a VLP-16"
    /// The beam angles of each HDL-64E are calibrated individually, and its packets do not contain them.
    NoVelodyneCalibration Warning "an HDL-64E without its calibration was read with nominal angles; put the calibration of velodyne_pointcloud (.yaml) beside the capture under the same name"
    /// A block of a Velodyne packet begins with neither of the two block marks, or its azimuth is invalid.
    DamagedVelodyneBlock Error "blocks of packets with a wrong mark or azimuth were left out"
    /// The length of an Ouster lidar packet differs from that of its layout.
    WrongOusterLength Error "Ouster packets of an unexpected length were left out"
    /// The sensor measured nothing in this column, or marked it as disturbed.
    InvalidOusterColumn Info "columns of Ouster packets that the sensor marked as invalid were left out"
    /// The length of an Ouster IMU packet is wrong.
    WrongOusterImuLength Error "Ouster IMU packets of an unexpected length were left out"
    /// The sensor measured nothing at that time.
    InvalidOusterSample Info "samples of an Ouster's IMU that the sensor marked as invalid were left out"
    /// The metadata were not found beside the capture under its name, but in another file.
    OusterMetadataFound Info "the metadata of an Ouster were read from {file}: {reason}"
    /// Metadata under the capture's name are used although the serial number differs: they are assumed to be intended.
    OtherOusterMetadata Warning "the metadata of an Ouster in {file} are of the serial number {metadata}, its packets of {packets}; they were used because there are no others"
    /// The metadata are of another sensor or another setting.
    WrongOusterMetadata Warning "the metadata of an Ouster do not fit its packets and were not used"
    /// The beam angles are calibrated individually, and only the metadata contain them.
    NoOusterMetadata Warning "an Ouster without its metadata was read with nominal beam angles: points are off by centimetres at short range and by metres at long range; put its metadata (.json) beside the capture, best under the same name"
    /// The sensor counts time from power-on, or its clock is wrong.
    SensorClockNotSet Info "the clock of a sensor was not set; its times were shifted to those of the recording"
    /// The clock of a sensor was set while it measured.
    SensorClockJumped Info "the clock of a sensor jumped by more than a second against the times of arrival; the jump was removed"
    /// A fragment of a datagram that would be too long when reassembled.
    LongDatagram Error "fragments of datagrams beyond the maximum length of a datagram were left out"
    /// Fragments were lost in the network, or the capture begins or ends between them.
    IncompleteDatagram Error "datagrams with missing fragments were left out"

    // Transforms and clocks.
    MapTransform Info "transforms from \"{parent}\" to \"{child}\" were not used: that is the output of a mapping program"
    NamelessTransform Error "transforms without the name of a frame were left out"
    InvalidTransform Error "transforms from \"{parent}\" to \"{child}\" with an invalid pose were left out"
    TransformLoop Error "the transforms {frames} form a loop; the last one is not used"
    TooManyFrames Error "there are more than {most} frames; transforms of \"{frame}\" and later ones are not used"
    SecondParent Info "frame \"{child}\" has two parents, \"{parent}\" and \"{second}\"; the second is not used"
    RecordingClockJump Warning "the clock of the recording jumps {by} at message {message} of the sensors: {time} comes after {before}"
    UnknownPoseAtTime Error "messages were left out: the pose of \"{child}\" in \"{parent}\" is not known at their time"
    UnknownFrame Error "messages were left out: {error}"
    MessageWithoutStamp Info "messages without a stamp got the time of recording"
    ClockJump Info "the clock jumped; the jump was removed from the stamps after it"
    StampFarFromRecording Error "messages whose stamp jumps away from the time of recording by more than 10 s were left out"
    StampsEvened Info "stamps come in bursts, go back or jitter; they were replaced by times from the order of arrival and the usual rate (--stamps as-is keeps them)"
    OdometryRepeats Info "odometry poses that repeat the one before were left out: scans show that the robot moved meanwhile"
    RepeatedStamp Error "measurements with the time of the one before were left out"
    StampBackward Error "measurements with an earlier time than the one before were left out"

    // Messages of sensors.
    OtherMessageType Error "messages of another type than before were left out"
    ScanNotSubdivided Info "scans whose points all have the same time were not subdivided"
    NoDistance Info "messages without a single valid range were not matched"
    CloudWithoutCoordinates Error "clouds without fields x, y and z were left out"
    CloudFieldOutside Error "clouds with fields beyond the end of a point were left out"
    PointTimesInDoubt Error "the times of points do not fit the motion of the lidar, and it is not clear which times would fit: the map may be bent (set with --point-times what they mean)"
    CloudInMillimetres Warning "clouds in millimetres were converted to metres"
    PointNotFinite Info "points that are not a number or beyond 1,000 km were left out"
    PointTimeFar Info "points whose time is far outside the time span of their cloud were left out"
    PointAtOrigin Info "points at (0, 0, 0) were left out as no return"
    PointsMissing Error "points are missing: clouds have fewer points than their width and height say"
    ReadingNotFinite Info "ranges that are not a number were taken as no return"
    ReadingNegative Info "negative ranges were left out"
    ReadingHuge Info "ranges beyond 1,000 km were left out"
    ScanLimitsWrong Info "scans whose range_min and range_max make no sense were read without those limits"
    AngleIncrementWrong Info "scans whose angle_min, angle_max and angle_increment do not fit together were read with those of them that are usable"
    TimeIncrementWrong Info "scans with an impossible time_increment were read as if all their points were measured at the same time"
    SampleNotFinite Error "samples that are not a number were left out"
    SampleImpossible Error "samples beyond what an IMU can measure (80 rad/s, 400 m/s²) were left out"
    SampleStuck Warning "samples that have repeated to the last digit for more than 0.1 s were left out: nothing new was measured"
    SamplePartial Error "samples marked as having no acceleration or no angular velocity (covariance −1) were left out"
    InvalidPose Error "invalid poses were left out"
    QuaternionNormalised Info "quaternions of a wrong length were normalised"
    InvalidFix Error "satellite fixes that are not a place on Earth were left out"
    FixesNotUsed Warning "nodes whose satellite fixes were not used: they contradict the map, or the robot moved too little for a heading"
    LandmarkWithoutTransform Info "landmarks without a transform are taken as seen from the tracking frame"
    InvalidLandmark Error "landmarks with an invalid pose or weight were left out"
    SensorSilent Warning "falls silent {seconds} s before the end; the rest is mapped without it"

    // Mapping. Issues that every recording has at its start and between overlapping sweeps do not count as loss.
    BeforeAllSensors Info "measurement before all sensors had started"
    OutOfOrderInSensor Error "measurement out of order in its sensor"
    MeasurementLate Error "measurement that came too late"
    SensorStalled Warning "sensor sent nothing for too long; the other sensors were used without waiting for it"
    UnknownSensor Error "measurement of an unknown sensor"
    PointOlderThanScan Warning "point older than the end of the scan before, left out"
    PointWithoutTime Error "point whose time is not a number, left out"
    PointsReordered Info "message whose points had to be put in order of time"
    UnexpectedRangeSensor Error "message of a range sensor that is not expected, left out"
    ScanCutShort Warning "scan matched before all its messages were there: more than 5 million points (lower num_accumulated_range_data)"
    ScanBeforeImu Info "scan before the first IMU sample"
    ScanOverlapsLast Warning "scan that starts before the last matched scan ends"
    ScanTooOld Warning "scan that ends before the last matched scan"
    ScanWithoutPoints Info "scan without points"
    ScanWithoutReturn Info "scan without a single return"
    ScanWithoutReturnInRange Warning "scan without a return in matching range"
    ScanOccluded Warning "scan in which something occludes everything that the map contains at this place; not inserted"
    ScanWithoutIntensities Warning "scan without intensities, matched by its shape alone"
    ScanPointsTooOld Warning "scan with points older than ones already used; they were placed at the last known pose"
    ScanWithoutPose Error "scan whose pose could not be determined"
    ScanContradictsMap Warning "scan that contradicts the map; not inserted"
    ReturnsMoveAlong Info "scan from which returns that move along with the robot were removed: of the robot itself, or of a person walking beside it"
    ReturnsOcclude Info "scan from which returns that occlude known parts of the map were removed: most likely of people"
    ScanFarFromPrediction Info "scan matched far from its predicted pose"
    ScanAfterGapFound Info "scan after a gap in all sensors, relocalised by a wide search"
    ScanAfterGapNotFound Warning "scan after a gap in all sensors, not relocalised; its pose is a guess"
    ScanFitsNoPlane Warning "scan that fits no plane; its pose follows from odometry, IMU, constant velocity or matching to grids"
    TravelGuessed Error "scan whose travelled distance no sensor has measured for seconds; constant velocity was assumed"
    GapUncertain Error "gap in which no sensor measured the travelled distance; the scans after it fit other poses nearly as well, see mostly new surroundings, or fit best after a large unmeasured rotation: everything after it may be misplaced"
    OdometryOverruled Warning "scan whose motion contradicts odometry, which was not used"
    OdometryCorrected Warning "odometry measures {factor} times the distance of scans; it was corrected by this factor"
    GyroscopeOverruled Warning "sweep whose rotation contradicts the gyroscope; the rotation found by matching was used"
    ImuSampleTooOld Warning "IMU sample older than the last matched scan"
    ImuSampleNotFinite Error "IMU sample that is not finite"
    ImuAfterStart Warning "IMU sample after a start without an IMU; only its angular velocity is used"
    OdometryTooOld Warning "odometry pose older than the last matched scan"
    OdometryJumped Info "odometry that jumped to another pose"
    GridTooLarge Error "scan left out of a submap, whose grid would have become too large (coarser cells help)"
    NoSubmapPossible Error "scan for which no submap could be made with these options"
    ScansNotKept Info "scans could not be kept on disk for pictures; the recording is read again for them"
    PoseNotFinite Error "poses of the result are not finite, no rotations, or earlier than those before them; they were left out of the trajectory"
    GraphUnsound Error "the map cannot be trusted: {finding}"
    GraphOutOfOrder Error "nodes of the map are out of order: {finding}"

    // Maps in files.
    UpdateMarker Info "update marker removed from a cell"
    KnownBoxRecomputed Info "bounding box of the known cells of a grid recomputed"
    CostBoundsReplaced Info "bounds of a distance field set to its truncation distance"
    WallDirectionsMissing Info "3D submap without rotational histogram, searched at every yaw; `migrate` adds it"
    CellOutside Error "cell outside of what a grid in 3D can hold, left out"
    CellInvalid Error "cell in 3D with an impossible value, left out"
    CellRepeated Error "cell in 3D that occurs twice"
    PlanesDamaged Info "damaged planes of a submap, recomputed from the points of its nodes"
    SecondPoseGraph Error "second pose graph"
    SecondOptions Error "second list of options"
    UnknownMapMessage Error "message of an unknown kind"
    SecondMapPose Error "second pose of a submap or node"
    InvalidStart Error "start that is not valid or relative to a trajectory that the map does not have"
    UnknownSensorKind Error "sensor of an unknown kind left out"
    SubmapUnplaced Error "submap that occurs twice or has no pose in the pose graph"
    NodeUnplaced Error "node that occurs twice or has no pose in the pose graph"
    InvalidImuCalibration Error "gravity or IMU calibration that is not valid or of no trajectory"
    InvalidFixedFrameOrigin Error "fixed-frame origin that is not valid or of no trajectory"
    ConstraintWeight Error "constraint with impossible weights"
    ConstraintUnconnected Error "constraint to a node or submap that the map does not have"
    ConstraintKindUnknown Info "constraint of an unknown kind taken for a loop closure"
    LandmarkWithoutPose Error "landmark without a valid pose"
    SubmapMissing Error "pose of a submap that the map does not have"
    NodeMissing Error "pose of a node that the map does not have"
    MeasurementOfNoTrajectory Error "measurement of a trajectory that the map does not have"
    OdometryWithoutPose Error "odometry without a valid pose"
    FixedFramePoseInvalid Error "fixed-frame pose that is not valid"
    LandmarkSightingInvalid Error "landmark sighting without a valid pose or with impossible weights"
    MeasurementWithoutContent Error "measurement without content"
    MeasurementRepeated Error "measurement with the stamp of an earlier one"

    // Clouds in files.
    CloudPointNotFinite Info "points whose coordinates are not numbers were left out"
    CloudPointsOutsideBounds Error "points lie outside the bounds that the header states: the file is damaged"
    CloudPointsMissing Error "points are missing: the file has fewer than its header states"
    CloudDamage Error "points after the damaged part of the file were left out"
    CloudLineUnreadable Error "lines that are not points were left out"
    CloudLineTooLong Error "lines longer than 64 KiB were left out"
    CloudLineShort Error "lines with fewer than three numbers were left out"
    CloudLineNotNumbers Error "lines that are not numbers were left out"
}

impl IssueKind {
    /// Name in reports, in snake case.
    pub fn name(self) -> String {
        let mut name = String::new();
        for letter in self.identifier().chars() {
            if letter.is_ascii_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(letter.to_ascii_lowercase());
        }
        name
    }
}

impl serde::Serialize for IssueKind {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.name())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_and_texts_are_unique() {
        let texts: BTreeSet<&str> = IssueKind::ALL.iter().map(|kind| kind.text()).collect();
        assert_eq!(texts.len(), IssueKind::ALL.len());
        assert_eq!(IssueKind::ScanBeforeImu.name(), "scan_before_imu");
        assert!(IssueKind::ALL.is_sorted());
    }
}
