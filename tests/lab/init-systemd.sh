#!/bin/busybox sh
# Process 1 of the lab's guest until systemd is: make vcan0 and a root to be thrown away.
#
# `lab` copies this file into a job directory, beside
#   settings   shell variables: kind, that of the guest, uml or qemu
#   root       link to the root: a squashfs image, which is also the first disk, or a directory
#   shared     folders of the machine, one a line, to be seen read-only at the same path
#   packages   Debian packages beside it, one a line, to be installed before it boots
#   modules    one "path parameters" per line, in loading order
#   attend     what runs the command, as lab.service; its files are there too
# The root is below an overlay in memory. What the machine must not do to the command, and what
# costs time and serves nobody, is masked in the overlay. So is tmp.mount, which Debian 13 has: it
# would hide the shared folders below /tmp. The overlay's own /tmp is in memory anyway.
job=${0%/*}
masked="getty.target serial-getty@.service console-getty.service modprobe@.service
    proc-sys-fs-binfmt_misc.automount systemd-update-utmp.service
    systemd-update-utmp-runlevel.service systemd-pstore.service systemd-tmpfiles-clean.timer
    systemd-networkd-wait-online.service apt-daily.timer apt-daily-upgrade.timer
    tmp.mount dpkg-db-backup.timer fstrim.timer e2scrub_reap.service kmod-static-nodes.service"
path=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin

# By its path: this shell finds its other built-in programs through /proc/self/exe.
/bin/busybox mount -t proc proc /proc
exec >/dev/console 2>&1

give_up() { echo "lab: $*"; poweroff -f; }

. "$job/settings"
case $kind in
uml)
    disk=/dev/ubda
    show() { mount --bind "$1" ".$1" && mount -o remount,bind,ro ".$1"; }
    become() {
        pivot_root . mnt || give_up 'cannot change the root'
        /mnt/bin/busybox chroot . /mnt/bin/busybox umount -l /mnt
        exec env -i TERM=dumb PATH=$path chroot . "$@"
    } ;;
qemu)
    disk=/dev/vda
    folders=0
    show() {
        mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,ro,cache=loose \
            folder$folders ".$1"
        folders=$((folders + 1))
    }
    become() {
        mkdir -p usr/lib/modules
        mount --bind /lib/modules usr/lib/modules # udev takes its drivers from there
        exec env -i TERM=dumb PATH=$path switch_root . "$@"
    } ;;
esac

while read -r module; do
    insmod $module || give_up "cannot load $module"
done <"$job/modules"
ip link set lo up
ip link add dev vcan0 type vcan && ip link set vcan0 up || give_up 'cannot create vcan0'

mount -t tmpfs -o mode=755 tmpfs /run
mkdir -p /run/lower /run/upper/root /run/upper/work /run/root
if [ -d "$job/root" ]; then
    mount --bind "$job/root" /run/lower
else
    mount -t squashfs -o ro $disk /run/lower
fi || give_up "cannot mount $(readlink "$job/root")"
[ -x /run/lower/lib/systemd/systemd ] || give_up "no systemd in $(readlink "$job/root")"
mount -t overlay -o lowerdir=/run/lower,upperdir=/run/upper/root,workdir=/run/upper/work \
    overlay /run/root || give_up 'cannot lay memory over the root'
cd /run/root

while read -r folder; do
    mkdir -p ".$folder" && show "$folder" || give_up "cannot show $folder"
done <"$job/shared"
mount -t tmpfs -o mode=755,nosuid,nodev tmpfs run
mkdir -p run/lab/job
mount --bind "$job" run/lab/job
ln -s /sys/fs/cgroup/system.slice/lab.service run/lab/cgroup

mount -t proc proc proc
mount -t devtmpfs devtmpfs dev
while read -r package; do
    env -i PATH=$path DEBIAN_FRONTEND=noninteractive chroot . \
        apt-get install -qq -y --no-install-recommends "/run/lab/job/$package" </dev/null ||
        give_up "cannot install $package"
done <"$job/packages"

for unit in $masked; do ln -sf /dev/null "etc/systemd/system/$unit"; done
: >etc/fstab
echo lab >etc/hostname
[ "$(wc -c <etc/machine-id)" = 33 ] || echo 6c61626c61626c61626c61626c61626c >etc/machine-id
cat >etc/systemd/system/lab.service <<'UNIT'
[Unit]
Description=The command of the lab
After=multi-user.target
SuccessAction=poweroff-immediate
FailureAction=poweroff-immediate
[Service]
Type=exec
Environment=job=/run/lab/job
ExecStart=/bin/sh ${job}/attend
Delegate=yes
OOMPolicy=continue
LimitNOFILE=4096:524288
UNIT
mkdir -p etc/systemd/system/multi-user.target.wants
ln -s ../lab.service etc/systemd/system/multi-user.target.wants/lab.service

become /lib/systemd/systemd --unit=multi-user.target
