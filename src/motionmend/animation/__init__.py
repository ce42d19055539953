"""The job `animate`: one pose and the paths of any joints become movements of the same rig.

In: a take with the pose, and trajectories from CSV, arrays or another take. Out: takes, and a report of how near given
paths were met. It must not know corpora, benchmarks, or the jobs of `composition`.
"""
