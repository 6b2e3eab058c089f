#!/bin/sh
# Run the lab's command with its output and its signals connected, and hand back its status.
#
# Read by init.sh, or a service of its own under systemd (init-systemd.sh). In $job:
#   settings   shell variables: kind (uml or qemu), stdout, stderr (tty, pipe or merged), rows, cols, interactive
#   command    the script that becomes the command
#   began      made here as soon as the command starts
#   status     the command's exit status; absent if the guest died before the command ended.
# Console 0, read, takes signal names for the command; console 1 is its stdout, console 2 its
# stderr. $run/cgroup is a control group in which the command gets one of its own.
run=/run/lab
mkdir $run/cgroup/command

. "$job/settings"
case $kind in
uml) console=/dev/tty ;;
qemu) console=/dev/hvc ;;
esac
exec 8>${console}1 9>${console}2 # a console forgets its window size when the last one closes it
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
relays=
: >"$job/began"
# The brackets keep this shell's own "Killed" and "Terminated" out of the command's stderr.
if [ "$interactive" ]; then
    stty -F ${console}1 sane rows "$rows" cols "$cols"
    (setsid -c "$job/command" <${console}1 >${console}1 2>&1 8>&- 9>&-)
else
    channel stdout "$stdout" ${console}1
    channel stderr "$stderr" ${console}2
    while read -r signal; do kill -"$signal" -"$(cat $run/group)"; done <${console}0 &
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
