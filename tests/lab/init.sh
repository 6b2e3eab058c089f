#!/bin/busybox sh
# Process 1 of the lab's guest: make vcan0, run the command, power off.
#
# `lab` copies this file into a job directory, beside
#   settings   SHELL variables: kind (uml), stdout, stderr (tty, pipe or merged), rows, cols, interactive
#   modules    one "path parameters" per line, in loading order
#   command    the script that becomes the command
#   attend     what runs it
# and reads `began` and `status`, see attend.sh. Console 0 is the kernel's log.
job=${0%/*}
run=/run/lab

# By its path: this shell finds its other built-in programs through /proc/self/exe.
/bin/busybox mount -t proc proc /proc
exec >/dev/console 2>&1

give_up() { echo "lab: $*"; poweroff -f; }

mount -t sysfs sysfs /sys
mount -t tmpfs -o mode=755 tmpfs /run
mkdir -p /dev/pts /dev/shm $run/cgroup
mkdir -m 1777 /run/tmp
mount -t devpts -o gid=5,mode=620,ptmxmode=666 devpts /dev/pts
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
mount -t cgroup2 cgroup2 $run/cgroup
mkdir $run/cgroup/command
ln -s /proc/self/fd /dev/fd
ln -s fd/0 /dev/stdin; ln -s fd/1 /dev/stdout; ln -s fd/2 /dev/stderr
hostname lab

while read -r module; do
    insmod $module || give_up "cannot load $module"
done <"$job/modules"
ip link set lo up
ip link add dev vcan0 type vcan && ip link set vcan0 up || give_up 'cannot create vcan0'

. "$job/attend"
poweroff -f
