#!/bin/busybox sh
# The first program in the lab's guest under QEMU, in its initramfs: reach the machine's folders,
# and become what `lab` put into the job directory (init-systemd.sh).
/bin/busybox mount -t proc proc /proc
mount -t devtmpfs devtmpfs /dev
exec >/dev/console 2>&1
mount -t sysfs sysfs /sys

give_up() { echo "lab: $*"; poweroff -f; }

while read -r module; do
    insmod "$module" || give_up "cannot load $module"
done </modules/order
attach() { mount -t 9p -o "trans=virtio,version=9p2000.L,msize=262144,$3" "$1" "$2"; }
attach job /job access=any || give_up 'cannot reach the job directory'
attach modules /lib/modules ro,cache=loose || give_up "cannot reach the kernel's modules"
exec /job/init
