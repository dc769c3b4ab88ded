#[link(name = "body")]
extern "C" {
    fn body_step(inverse: *const f64, h: f64, momentum: *mut f64, attitude: *mut f64) -> std::ffi::c_long;
}

/// Step a free body; None if the numbers are not finite, or the time is too long.
fn step(inertia: [f64; 3], h: f64, momentum: &mut [f64; 3], attitude: &mut [f64; 4]) -> Option<()> {
    let inverse = inertia.map(f64::recip);
    let pieces = unsafe { body_step(inverse.as_ptr(), h, momentum.as_mut_ptr(), attitude.as_mut_ptr()) };
    (pieces > 0).then_some(())
}

fn main() {
    let inertia = [1.0, 1.5, 2.5];
    let (mut momentum, mut attitude) = ([0.05, 1.5, 0.05], [1.0, 0.0, 0.0, 0.0]);
    for _ in 0..100 {
        step(inertia, 0.6, &mut momentum, &mut attitude).expect("a finite state");
    }
    println!("{:.9} {:.9} {:.9}", momentum[0], momentum[1], momentum[2]);
}
