"""Every row of docs/recordings.md has a test behind it: which."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs' / 'recordings.md').read_text(encoding='utf-8')
FILES = 'inputs/test_recording_files.py'
FRAMES, STAMPS = 'preflight/test_frames_and_poses.py', 'preflight/test_stamps_and_lag.py'
IMAGES, SENSORS = 'preflight/test_what_images_say.py', 'replay/test_sensors_replayed.py'
OTHER, ORDER = 'inputs/test_other_sensors.py', 'inputs/test_reading_order.py'
TRUST, INFO = 'preflight/test_confidence_images.py', 'preflight/test_info.py'
LABELS, SESSIONS = 'inputs/test_label_reader.py', 'replay/test_replay_inputs.py'
CONVERT, PATHS = 'convert/test_convert_frames.py', 'convert/test_trajectories.py'
# The beginning of a row, the file and the beginning of the name of the test behind it.
ROWS = {
    'a rosbag2 folder, its': (FILES, 'test_metadata_given_as_the_recording'),
    'a folder above one': (FILES, 'test_a_folder_above_a_recording'),
    'a folder above several': (FILES, 'test_a_folder_above_a_recording'),
    'a split file that was': (FILES, 'test_a_split_file_that_is_missing_is_named'),
    'files that differ from the': (FILES, 'test_counts_of_metadata_that_differ'),
    '`metadata.yaml` lost': (FILES, 'test_qos_of_metadata_does_not_matter'),
    'files renamed': (FILES, 'test_files_that_were_renamed'),
    'a file beside those': (FILES, 'test_a_file_beside_the_listed_ones'),
    '`.mcap.zstd`': (FILES, 'test_compressed_files'),
    'a `.db3-wal`': (FILES, 'test_a_write_ahead_log_is_read'),
    'a file that was cut off': ('inputs/test_bad_recordings.py', 'test_a_recording_that_was_cut'),
    'a ROS 1 `.bag`': (FILES, 'test_files_that_are_something_else'),
    '`.mcap` with messages': (FILES, 'test_messages_of_other_systems'),
    'an archive, a Git': (FILES, 'test_files_that_are_something_else'),
    'poses of the body without': (FRAMES, 'test_a_body_pose_is_told_from_a_camera_pose'),
    'a camera info of another camera': (FRAMES, 'test_the_right_camera_info_is_found'),
    'no frame called `map`': (FRAMES, 'test_the_only_root_is_the_map_frame'),
    'a body pose and a gimbal': (FRAMES, 'test_a_gimbal_on_tf_is_followed'),
    'a child frame, typed': (FRAMES, 'test_what_is_said_of_the_poses_and_depth'),
    'odometry in `odom`': (FRAMES, 'test_odometry_is_carried_to_the_map'),
    'poses in another frame': (FRAMES, 'test_poses_in_another_frame_are_the_maps'),
    'a body that two sources': (FRAMES, 'test_two_parents_that_take_turns'),
    'images without a `frame_id`': (FRAMES, 'test_images_that_name_no_frame'),
    'images or poses in a frame that': (FRAMES, 'test_a_frame_that_is_not_optical'),
    "PX4's `VehicleOdometry`": ('preflight/test_px4.py', 'test_frames_are_where_the_camera_was'),
    '`map` → `odom` at 1 Hz': (FRAMES, 'test_a_slow_link_is_named_with_both_settings'),
    '`/r1/tf` and `/r2/tf`': (FRAMES, 'test_transforms_are_those_of_the_robot'),
    'poses that jump': (FRAMES, 'test_poses_that_jump_are_not_interpolated'),
    'poses that come seldom': (FRAMES, 'test_poses_too_seldom_for_the_motion_are_said'),
    'one pose that is far off': (FRAMES, 'test_one_wild_pose_costs_one_frame'),
    'one pose a few metres': (FRAMES, 'test_one_pose_that_is_a_little_wild_is_said'),
    'labels stamped when': (STAMPS, 'test_labels_stamped_late_are_refused'),
    'late labels that happen': (STAMPS, 'test_a_lag_that_brings_all_labels_near'),
    'labels that are all beside': (IMAGES, 'test_labels_always_beside_their_depth'),
    'labels computed from': (INFO, 'test_labels_stamped_a_day_later'),
    'labels slower than the depth': (STAMPS, 'test_a_lag_that_is_ambiguous_by_the_period'),
    'labels anywhere between': (STAMPS, 'test_labels_anywhere_between_images_are_doubted'),
    'all labels have depth but': (STAMPS, 'test_labels_after_the_last_depth_may_be_late'),
    'a camera info whose optical': (IMAGES, 'test_an_axis_that_misses_the_image_is_said'),
    'late by a varying time': (STAMPS, 'test_jitter_beyond_the_tolerance'),
    'stamps that are 0': (STAMPS, 'test_zero_stamps_are_named'),
    'clocks that do not overlap': (STAMPS, 'test_clocks_that_do_not_overlap'),
    'poses whose clock': (STAMPS, 'test_poses_of_a_clock_that_is_seconds_off'),
    'poses slower than': (STAMPS, 'test_slow_poses_name_max_gap'),
    'frames that were dropped': (STAMPS, 'test_labels_without_depth_are_summed_up'),
    'labels (or poses) recorded': (ORDER, 'test_labels_recorded_a_day_later'),
    'a drive and its labels': (SESSIONS, 'test_drive_and_labels_in_two_recordings'),
    'the same topic in both': (FILES, 'test_one_topic_in_both_recordings'),
    'several flights over': (SESSIONS, 'test_recordings_in_a_row_are_sessions'),
    'flights whose legends': (SESSIONS, 'test_ids_of_a_second_session_follow'),
    'from the tenth': (ORDER, 'test_seconds_count_from_the_first_complete'),
    'between two stamps': (ORDER, 'test_start_and_end'),
    'every fifth': (ORDER, 'test_every_third_complete_frame'),
    '`16UC1` or `mono16`': ('inputs/test_image_messages.py', 'test_depth_of_other_encodings'),
    'another unit': ('preflight/test_depth_fit.py', 'test_a_unit_with_which_frames_agree'),
    'the distance along': ('preflight/test_depth_fit.py', 'test_the_kind_with_which_frames'),
    '`stereo_msgs/Disp': (IMAGES, 'test_a_disparity_image_is_depth'),
    'disparities in a': (IMAGES, 'test_disparities_without_a_baseline'),
    'depth of which': (IMAGES, 'test_depth_of_which_nothing_is_in_range'),
    '65535, or': (IMAGES, 'test_a_number_for_nothing_is_noticed'),
    'a camera info of another aspect': (IMAGES, 'test_a_camera_info_of_another_shape'),
    'no camera info at all': (IMAGES, 'test_a_recording_without_camera_infos'),
    'a confidence image, ZED': (SENSORS, 'test_depth_that_is_not_to_be'),
    'the same, RealSense': (SENSORS, 'test_depth_that_is_not_to_be'),
    'the same, OAK': (SENSORS, 'test_depth_that_is_not_to_be'),
    'the wrong sign of': (TRUST, 'test_they_are_refused'),
    'colours that are none': (LABELS, 'test_a_legend_that_fits_no_colour'),
    '`labels.channel=r` on': (IMAGES, 'test_one_channel_of_colours_is_refused'),
    'colours of a legend': (LABELS, 'test_colours_of_the_legend'),
    'ids in one channel': (LABELS, 'test_ids_in_one_channel_are_found'),
    'instances, class': (LABELS, 'test_instances_become_classes'),
    'the same, and nobody': (IMAGES, 'test_ids_of_instances_are_recognised'),
    'a mask of 0 and 255': (IMAGES, 'test_a_mask_of_0_and_255'),
    'a grey image': (IMAGES, 'test_a_grey_image_is_no_label_image'),
    'labels of another aspect': (LABELS, 'test_another_aspect_ratio_is_refused'),
    'sizes that are': ('inputs/test_camera.py', 'test_sizes_are_rounded_but_ratios_are_not'),
    'a confidence image of the': (SENSORS, 'test_a_confident_minority_wins'),
    'names as `vision': ('inputs/test_names.py', 'test_tables_of_every_form'),
    'such names, and `labels.legend` gives': (
        'inputs/test_naming.py', 'test_ids_that_move_and_names_without'),
    'such names, and `labels.legend` calls': (
        'inputs/test_naming.py', 'test_names_that_differ_alone'),
    'the same, and `persem evaluate`': (
        'evaluate/test_evaluate.py', 'test_ids_follow_the_names_of_the_taxonomy'),
    'names that cannot': (SENSORS, 'test_a_table_that_cannot_be_read'),
    'poses that were corrected': (
        'replay/test_trajectory.py', 'test_corrected_is_as_if_recorded_right'),
    'labelled clouds': (SENSORS, 'test_a_labelled_cloud_is_mapped'),
    'label images and a LiDAR': (OTHER, 'test_a_lidar_gives_the_depth'),
    'labels and depth of two': (OTHER, 'test_depth_of_another_camera_takes_the_label'),
    'the same without that': (OTHER, 'test_without_their_camera_info_labels'),
    'TUM, `stamp': (CONVERT, 'test_tum_with_clocks_of_their_own'),
    'the same with w first': (PATHS, 'test_tum_with_w_first_is_told_by_depth'),
    'EuRoC': (PATHS, 'test_euroc_has_nanoseconds'),
    'SceneNN': (PATHS, 'test_scenenn_counts_blocks'),
    'ARKitScenes': (PATHS, 'test_arkitscenes_turns_by_axis'),
    'KITTI': (CONVERT, 'test_kitti_trajectories'),
    '7-Scenes': (PATHS, 'test_seven_scenes_has_unregistered_colour'),
}


def rows():
    """Return the first cell of each row of the page."""
    lines = [line for line in PAGE.splitlines() if line.startswith('| ')]
    return [cell for line in lines
            if not (cell := line.split('|')[1].strip()).startswith('what you ')]


def test_every_row_is_in_the_table_and_the_other_way_round():
    assert len(rows()) == len(ROWS)
    for row in rows():
        assert sum(row.startswith(start) for start in ROWS) == 1, row


@pytest.mark.parametrize('start', ROWS)
def test_the_test_behind_a_row_is_there(start):
    path, name = ROWS[start]
    found = re.findall(rf'^def {name}\w*\(', (ROOT / 'test' / path).read_text(), re.MULTILINE)
    assert found, f'{path}: {name}'
