#!/bin/busybox sh
# Process 1 of the lab's guest: make vcan0, run the command, hand back its status, power off.
#
# `lab` copies this file into a job directory, beside
#   settings   SHELL variables: stdout, stderr (tty, pipe or merged), rows, cols, interactive
#   modules    one "path parameters" per line, in loading order
#   command    the script that becomes the command
# and reads
#   status     the command's exit status; absent if the guest died before the command ended.
# Console 0 is the kernel's log and, read, takes signal names for the command;
# console 1 is the command's stdout, console 2 its stderr.
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

exec 8>/dev/tty1 9>/dev/tty2 # a console forgets its window size when the last one closes it
# A pipe in front of the console where the caller's output is no terminal, so that isatty()
# and buffering are what they are outside; a terminal where it is one.
channel() { # NAME KIND CONSOLE
    case $2 in
    tty)
        stty -F "$3" -onlcr -echo rows "$rows" cols "$cols"
        ln -s "$3" "$run/$1" ;;
    pipe)
        stty -F "$3" raw -echo
        mkfifo "$run/$1"
        cat <"$run/$1" >"$3" &
        relays="$relays $!" ;;
    merged)
        ln -s "$run/stdout" "$run/$1" ;;
    esac
}
. "$job/settings"
relays=
# The brackets keep this shell's own "Killed" and "Terminated" out of the command's stderr.
if [ "$interactive" ]; then
    stty -F /dev/tty1 sane rows "$rows" cols "$cols"
    (setsid -c "$job/command" </dev/tty1 >/dev/tty1 2>&1 8>&- 9>&-)
else
    channel stdout "$stdout" /dev/tty1
    channel stderr "$stderr" /dev/tty2
    while read -r signal; do kill -"$signal" -"$(cat $run/group)"; done </dev/tty0 &
    (setsid "$job/command" </dev/null >$run/stdout 2>$run/stderr 8>&- 9>&-)
fi
status=$?

# What the command left behind ends with the guest, and must not hold its output open.
echo 1 >$run/cgroup/command/cgroup.kill
[ "$relays" ] && wait $relays
exec 8>&- 9>&- # waits for the last of the output
sync
echo $status >"$job/status"
sync
poweroff -f
